"""A node in lockstep tells the environment which neighbours are out of its reach."""

from collections.abc import Callable
from unittest.mock import patch

import pytest
from msgspec.structs import replace

from concord.nodes.messages import Unreachable, decode
from concord.nodes.node import initial_state
from concord.runtime.network.links import ZenohEndpoints
from concord.runtime.processes.node import lockstep
from concord.runtime.processes.node.membership import Membership
from tests.nodes.one_node import middle_node
from tests.processes import holds_within


class Quiet:
    """A transport on which nothing is said but what the node says."""

    def __init__(self) -> None:
        self.said: list[tuple[str, bytes]] = []
        self.away, self.woken = set[str](), set[str]()
        self.told: Callable[[str, bool], None] = lambda name, is_there: None

    def listen(self, topic: str, heard: Callable[[str, bytes], None]) -> None: ...

    def receive(self, topic: str) -> None: ...

    receive_at_once = receive

    def watch(self, told: Callable[[str, bool], None]) -> None:
        self.told = told

    def wake(self, topic: str) -> None:
        self.woken.add(topic)

    def send(self, topic: str, data: bytes) -> None:
        self.said.append((topic, data))

    def missing(self, names: list[str]) -> list[str]:
        return [name for name in names if name in self.away]


@pytest.mark.parametrize(("returns", "is_out"), [(False, False), (True, False), (False, True)])
def test_a_neighbour_out_of_reach_is_named_unless_it_returns_or_is_out(returns: bool, is_out: bool):
    """A node that returns may link to a new neighbour later than it is let in."""
    quiet, config = Quiet(), middle_node()
    membership = Membership("quiet", ZenohEndpoints("peer", (), ()), config, "")
    with (
        patch.object(lockstep, "Transport", lambda *_: quiet),
        patch.object(lockstep, "_GRACE_S", 0.0),
    ):
        node = lockstep.LockstepNode(membership)
        quiet.away = {"0"}
        quiet.told("0", False)
        assert holds_within(30.0, lambda: "share/0" in quiet.woken)
    quiet.away -= {"0"} if returns else set()
    state = replace(initial_state(config), absent=frozenset({0} if is_out else ()))
    node.next_events(config, state)
    told = [decode(*said) for said in quiet.said if said[0].startswith("unreachable")]
    assert told == ([] if returns or is_out else [Unreachable(1, 0)])
