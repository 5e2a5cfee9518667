"""How the process of a node belongs to a network of processes."""

import math
from collections.abc import Mapping

import msgspec

from concord.nodes.node_state import NodeConfig
from concord.runtime.network.links import ZenohEndpoints, peers_of


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
