"""The world's process: what has come in time counts, however late it looks, and what holds is said
where nobody goes on."""

import threading
from collections import deque

import pytest

from nodes import said, world_process
from nodes.changes import Gone
from nodes.commands import Kill, Restart
from nodes.links import Links
from nodes.management import Management
from nodes.messages import Bid, BidsClosed, Grant, decode, encode, topic
from nodes.notices import Hello, Presence, Recorded
from nodes.tempo import Tempo
from nodes.world import WorldConfig
from nodes.world_timetable import Beat
from scenarios.build import build_world
from tests.experiments.support import small


class Wire:
    """A transport that brings what a test lays on it, and keeps what is sent."""

    def __init__(self, *_: object, **__: object) -> None:
        self.waiting: dict[str, deque[tuple[str, bytes]]] = {
            "bid/*": deque(),
            "estimate/*": deque(),
        }
        self.sent: list[tuple[str, bytes]] = []
        # Set when "gone" is said among what is said again.
        self.spoken = threading.Event()

    def listen(self, *_: object) -> None: ...

    def answer(self, *_: object) -> None: ...

    def wake(self, _: str) -> None: ...

    def missing(self, names: list[str]) -> list[str]:
        return names

    def receive_at_once(self, subscription: str) -> tuple[str, bytes] | None:
        waiting = self.waiting[subscription]
        return waiting.popleft() if waiting else None

    def send(self, name: str, data: bytes) -> None:
        self.sent.append((name, data))
        if name == "gone":
            self.spoken.set()

    offer = send


class Aside:
    """Nothing was ever too much for a queue."""

    def __init__(self, *_: object) -> None: ...

    def take(self) -> list[tuple[str, bytes]]:
        return []


def office_of(
    monkeypatch: pytest.MonkeyPatch, config: WorldConfig, tempo: Tempo | None
) -> tuple[world_process._Office, Wire]:
    """A world that nobody has joined, and its transport."""
    monkeypatch.setattr(world_process, "Transport", Wire)
    monkeypatch.setattr(world_process, "Overflow", Aside)
    nobody = Management(
        lambda node: None, lambda node: None, lambda given: given, lambda step: None, b"{}"
    )
    links = Links("peer", (), (), 1.0)
    office = world_process._Office("run", links, config, "a" * 64, nobody, (), tempo)
    wire = office._transport
    assert isinstance(wire, Wire)
    return office, wire


def test_the_world_says_again_who_is_gone_where_nobody_goes_on(monkeypatch: pytest.MonkeyPatch):
    office, wire = office_of(monkeypatch, build_world(small(steps=3)), None)
    monkeypatch.setattr(said, "_AGAIN_S", 0.01)
    office._attend(Presence(2, False))
    wire.sent.clear()
    wire.spoken.clear()
    office._said.begin()
    assert wire.spoken.wait(20)
    office._said.close()
    assert ("gone", encode(Gone(2))) in wire.sent


@pytest.mark.parametrize("came", [0, 1, 2])
def test_bids_that_are_there_when_the_world_looks_are_in_time(
    monkeypatch: pytest.MonkeyPatch, came: int
):
    """It was busy until after their end; who has not asked by then is named."""
    config = build_world(small(schedule="hybrid", occupancy=0.5, steps=3))
    office, wire = office_of(monkeypatch, config, Tempo(1.0, 0.02, 0.1))
    office._conductor.command(world_process.Speed(10.0))
    office._attend(Beat())
    state = office._conductor.state
    cycle, group = state.next_cycle, state.next_group
    contenders = config.schedule.contenders(cycle)
    for node in contenders[:came]:
        bid = Bid(node, cycle, 1, 30, group)
        wire.waiting["bid/*"].append((topic(bid), encode(bid)))
    office._attend(BidsClosed(cycle, group))
    [grant] = [decode(*one) for one in wire.sent if one[0] == "grant"]
    assert isinstance(grant, Grant)
    assert (grant.cycle, grant.group) == (cycle, group)
    assert set(grant.winners) <= set(contenders[:came])
    assert bool(grant.winners) == bool(came)
    assert list(grant.unheard or ()) == list(contenders[came:])


def test_a_killed_node_is_not_let_in_before_it_is_restarted(monkeypatch: pytest.MonkeyPatch):
    """Its process lives until the recorder has its last message, and hears that it is gone."""
    office, _ = office_of(monkeypatch, build_world(small(steps=9)), Tempo(1.0, 0.02, 0.1))
    office._conductor.command(world_process.Speed(10.0))
    office._conductor.command(Kill(2))
    office._attend(Beat())
    assert list(office._conductor.state.standing.absent) == [2]
    office._attend(Hello(2, "a" * 64))
    assert not office._conductor._ready
    office._attend(Recorded(2))
    office._attend(Presence(2, False))
    office._conductor.command(Restart(2))
    office._attend(Hello(2, "a" * 64))
    assert office._conductor._ready == {2}
