"""How a fresh process finds its way into a network that may run already."""

import time
from collections.abc import Collection

import msgspec

from concord.runtime.network.zenoh_transport import Transport

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
