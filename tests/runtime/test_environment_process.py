"""Test the environment process.

A bid that arrived in time counts, even if the process reads it late. Lasting facts are sent again
where no step goes on.
"""

import threading
from collections import deque
from collections.abc import Sequence
from typing import Any

import pytest

from concord.nodes.changes import Gone
from concord.nodes.commands import Kill, Restart, Scripted, Speed
from concord.nodes.environment_state import EnvironmentConfig
from concord.nodes.messages import Bid, BidsClosed, Grant, decode, encode, topic
from concord.nodes.tempo import Tempo
from concord.runtime.network.links import ZenohEndpoints
from concord.runtime.processes import republisher as said
from concord.runtime.processes.environment import inbox
from concord.runtime.processes.environment import process as environment_process
from concord.runtime.processes.environment.decisions import Deserted
from concord.runtime.processes.environment.gathering import await_processes
from concord.runtime.processes.environment.notices import Hello, Presence, RecorderCaughtUp
from concord.runtime.processes.environment.pacing import EnvironmentPacing, Lockstep, RealTime
from concord.runtime.processes.environment.process import EnvironmentProcess, Management
from concord.runtime.processes.environment.timetable import Beat
from concord.runtime.processes.job import NodeEnded
from concord.scenarios.build import build_environment
from tests.experiments.support import small


class Meeting:
    """A transport on which processes come at some calls, and others never."""

    def __init__(self, comes: dict[int, str]) -> None:
        self.calls, self.lacking, self._comes = 0, ["1", "2"], comes

    def await_present(self, names: Sequence[str], seconds: float) -> bool:
        self.calls += 1
        if self.calls in self._comes:
            self.lacking.remove(self._comes[self.calls])
        return not self.lacking

    def missing(self, names: Sequence[str]) -> list[str]:
        return self.lacking


def test_a_node_that_cannot_be_met_is_given_a_minute_and_named(capsys):
    network: Any = Meeting({})
    with pytest.raises(Deserted, match=r"node 1, node 2 cannot be met.* for 60 s.*concord doctor"):
        await_processes(network, ["1", "2"], 60.0)
    # Each call waits for 10 s, and the first tells how many lack.
    assert network.calls == 6
    assert capsys.readouterr().err.count("waits for node 1, node 2") == 5


def test_each_further_process_begins_the_minute_anew():
    network: Any = Meeting({4: "1"})
    with pytest.raises(Deserted, match=r"node 2 cannot be met.* for 60 s"):
        await_processes(network, ["1", "2"], 60.0)
    assert network.calls == 4 + 6
    await_processes(Meeting({3: "1", 8: "2"}), ["1", "2"], 60.0)  # type: ignore[arg-type]


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


def process_of(
    monkeypatch: pytest.MonkeyPatch,
    config: EnvironmentConfig,
    pacing: EnvironmentPacing,
    script: Sequence[Scripted] = (),
) -> tuple[EnvironmentProcess, Wire]:
    """An environment process that no node has joined, and its transport."""
    monkeypatch.setattr(environment_process, "Transport", Wire)
    monkeypatch.setattr(inbox, "Overflow", Aside)
    nobody = Management(
        kill=lambda node: None,
        start=lambda node, life: None,
        check=lambda _, given: given,
        on_step=lambda step: None,
        setup=b"{}",
        ends=-1,
    )
    links = ZenohEndpoints("peer", (), (), 1.0)
    process = EnvironmentProcess("run", links, config, "a" * 64, nobody, pacing, script)
    wire = process.transport
    assert isinstance(wire, Wire)
    return process, wire


def test_the_world_says_again_who_is_gone_where_nobody_goes_on(monkeypatch: pytest.MonkeyPatch):
    process, wire = process_of(monkeypatch, build_environment(small(steps=3)), Lockstep())
    monkeypatch.setattr(said, "_AGAIN_S", 0.01)
    process.attend(Presence(2, False))
    wire.sent.clear()
    wire.spoken.clear()
    process.republisher.begin()
    assert wire.spoken.wait(20)
    process.republisher.close()
    assert ("gone", encode(Gone(2))) in wire.sent


@pytest.mark.parametrize("came", [0, 1, 2])
def test_bids_that_are_there_when_the_world_looks_are_in_time(
    monkeypatch: pytest.MonkeyPatch, came: int
):
    """The process was busy until bidding ended; the grant names contenders without a bid."""
    config = build_environment(small(schedule="hybrid", occupancy=0.5, steps=3))
    process, wire = process_of(monkeypatch, config, RealTime(Tempo(1.0, 0.02, 0.1)))
    process.controller.command(Speed(10.0))
    process.attend(Beat())
    state = process.controller.state
    cycle, group = state.next_cycle, state.next_group
    contenders = config.schedule.contenders(cycle)
    for node in contenders[:came]:
        bid = Bid(node, cycle, 1, 30, group)
        wire.waiting["bid/*"].append((topic(bid), encode(bid)))
    process.attend(BidsClosed(cycle, group))
    [grant] = [decode(*one) for one in wire.sent if one[0] == "grant"]
    assert isinstance(grant, Grant)
    assert (grant.cycle, grant.group) == (cycle, group)
    assert set(grant.winners) <= set(contenders[:came])
    assert bool(grant.winners) == bool(came)
    assert list(grant.unheard or ()) == list(contenders[came:])


def test_a_killed_node_is_not_let_in_before_it_is_restarted(monkeypatch: pytest.MonkeyPatch):
    """Its process lives until the recorder has its last message, and hears that it is gone."""
    config = build_environment(small(steps=9))
    process, _ = process_of(monkeypatch, config, RealTime(Tempo(1.0, 0.02, 0.1)))
    controller, hello = process.controller, Hello(2, "a" * 64)
    controller.command(Speed(10.0))
    controller.command(Kill(2))
    process.attend(Beat())
    assert list(controller.state.standing.absent) == [2]
    # The kill is ordered when the recorder has kept all, and carried out a little later.
    for notice in (hello, RecorderCaughtUp(2), hello):
        process.attend(notice)
        assert not controller._ready
    process.attend(Presence(2, False))
    controller.command(Restart(2))
    process.attend(hello)
    assert controller._ready == {2}


def test_a_restart_that_dies_while_it_starts_holds_up_no_step(monkeypatch: pytest.MonkeyPatch):
    """The end of the process before it, told late, does not count."""
    config = build_environment(small(steps=9))
    script = [Scripted(0, Kill(2)), Scripted(0, Restart(2))]
    process, _ = process_of(monkeypatch, config, Lockstep(), script)
    controller = process.controller
    controller.begin()
    assert controller.state.released == 0
    process.attend(NodeEnded(2, 0))
    assert controller.state.released == 0
    process.attend(NodeEnded(2, 1))
    assert controller.state.released > 0


def test_who_has_come_back_is_told_until_it_asks_to_be_let_in(monkeypatch: pytest.MonkeyPatch):
    """A link that has just come back may lose the first word."""
    process, wire = process_of(monkeypatch, build_environment(small(steps=9)), Lockstep())
    again: list[tuple[float, Any]] = []
    monkeypatch.setattr(process, "_notify_later", lambda *after: again.append(after))
    monkeypatch.setattr(wire, "missing", lambda names: [])
    process.controller.begin()
    process.attend(Presence(2, False))
    wire.sent.clear()
    process.attend(Presence(2, True))
    for _ in range(2):
        [(seconds, notice)] = again
        again.clear()
        assert seconds > 0
        process.attend(notice)
    assert [name for name, _ in wire.sent].count("gone/2") == 3
    process.attend(Hello(2, "a" * 64))
    assert process.controller._ready == {2}
