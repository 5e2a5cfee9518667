"""How the process of a node belongs to a network of processes."""

import math
import time
from collections.abc import Collection, Mapping

import msgspec

from concord.nodes.node_state import NodeConfig
from concord.runtime.network.links import ZenohEndpoints, peers_of
from concord.runtime.network.zenoh_transport import Transport


class Membership(msgspec.Struct, frozen=True):
    """Everything that the process of a node is told, at any pace.

    Attributes:
        run: the name of the run, below which all its topics lie.
        links: how this process connects.
        config: what the node is.
        fingerprint: digest of the setup; the environment process refuses another than its own.
        late: it joins a network that may run already.
        endpoints: where nodes listen to which this one may have to open a link, when a change makes
            them neighbours; none where a router is between.
        peer_timeout_s: the process ends when it has been without the environment process for so
            long; infinite where a launcher process ends it.
    """

    run: str
    links: ZenohEndpoints
    config: NodeConfig
    fingerprint: str
    late: bool = False
    endpoints: Mapping[int, str] = {}
    peer_timeout_s: float = math.inf

    @property
    def peers(self) -> list[int]:
        """The nodes that this node hears or that hear it; all are there before the first share."""
        return peers_of(self.config.index, self.config.graph)


# Interval at which the node looks for peers.
_LOOK_S = 0.5


class Situation(msgspec.Struct):
    """The part of the network's state that a node must know to join it."""

    members: list[int]
    begun: bool


def await_links(transport: Transport, peers: Collection[int]) -> bool:
    """Wait until all `peers` are there that take part; whether the run has begun."""
    while True:
        answer = transport.ask("state")
        if answer is None:
            time.sleep(_LOOK_S)
            continue
        there = msgspec.json.decode(answer, type=Situation)
        linked = {str(j) for j in peers if j in there.members}
        if transport.await_present(linked, _LOOK_S):
            return there.begun
