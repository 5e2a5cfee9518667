"""Test deaths, hangs and late requests in real time: their cost per node and their reports."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby, zip_longest
from pathlib import Path

import numpy as np
import pytest

from concord.bus.flexray.share_frames import read_frame
from concord.nodes.changes import Event, Gone, Joined, Left
from concord.nodes.commands import in_words
from concord.nodes.messages import decode
from concord.nodes.tempo import Tempo
from concord.results.figures.timing_figures import TimingFigures, figures_of
from concord.results.records.trace import Trace
from concord.scenarios.build import build_environment
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from tests.experiments.support import broken_promises, small, trace_of
from tests.laboratory.running import Running
from tests.processes import PATIENCE_S, PROC, holds_within, lives

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]
STRUCK = 2
# A busy machine does not keep cycles of 20 ms; these last 60 ms, and steps 180 ms.
SLOWER = 3
# A death is seen when its links close, and not only after the two seconds of the lease.
SEEN_CYCLES = 17
# Three steps of three rounds.
AGREES_CYCLES = 9
HANG_S = 1.5


def slow_tempo(setup: Setup) -> Tempo:
    """Return the timetable of these tests."""
    return tempo_of(setup, SLOWER * tempo_of(setup, None).stretch)


class Played:
    """A network in real time that has ended: what was told, and what it amounts to."""

    def __init__(
        self,
        setup: Setup,
        folder: Path,
        messages: list[tuple[str, bytes]],
        tempo: Tempo | None = None,
    ) -> None:
        self.setup, self.messages = setup, messages
        self.trace: Trace = trace_of(setup, folder / "run.mcap")
        kept = tempo or slow_tempo(setup)
        self.figures: TimingFigures = figures_of(
            kept, messages, self.trace.counters, self.trace.estimate_age_s
        )
        assert broken_promises(setup, folder) == []

    def told(self, kind: str) -> list:
        """Messages of a topic, in the order in which they were recorded."""
        return [decode(t, data) for t, data in self.messages if t.partition("/")[0] == kind]

    def step_of(self, change: type) -> list[int]:
        """The first steps of all changes of a type."""
        events: list[Event] = self.told("event")
        return [event.step for event in events if isinstance(event.change, change)]

    def cycles_sent(self, node: int) -> set[int]:
        """Cycles in which a node has sent a share."""
        return {read_frame(data).cycle for t, data in self.messages if t == f"share/{node}"}

    def apart(self, node: int, first: int, last: int | None = None) -> float:
        """Root mean square distance of a node's estimates from the mean of the others'."""
        mean = self.trace.mean[first:last]
        others = np.delete(mean, node, axis=1).mean(axis=1)
        return float(np.sqrt(np.mean((mean[:, node] - others) ** 2)))


@contextmanager
def playing(setup: Setup, folder: Path, tempo: Tempo | None = None) -> Iterator[Running]:
    """A network in real time; it must come to its end by itself."""
    network = Running(setup, "realtime", folder, tempo=tempo or slow_tempo(setup))
    try:
        yield network
    finally:
        network.end()


def reaches(network: Running, step: int) -> bool:
    return holds_within(PATIENCE_S, lambda: network.client.state()["completed"] >= step)


def has_member(network: Running, node: int) -> bool:
    return node in network.client.state()["members"]


def say(network: Running, words: str) -> None:
    answer = network.client.command(in_words(words.split()))
    assert answer.accepted, answer.detail


def check_books(played: Played, gone: int, joined: int) -> None:
    """Every share that was due at a neighbour was heard or is counted as missed."""
    rounds = played.setup.scenario.rounds
    sent = played.cycles_sent(STRUCK)
    died, back = max(c for c in sent if c < joined * rounds), joined * rounds
    cycles = played.setup.scenario.steps * rounds
    assert min(c for c in sent if c > died) == back
    assert gone * rounds <= died + 1 <= back
    for node in played.setup.neighbours[STRUCK]:
        counters = played.trace.counters[node]
        # No node waits for it after its death was announced; before that each cycle is missed.
        due_of_struck = counters["heard"] + counters.get("missed", 0) - cycles
        # The share of its last cycle may have reached the recorder alone.
        assert died <= due_of_struck - (cycles - back) <= died + 1 + SEEN_CYCLES
        said = [one for one in played.told("timing") if one.node == node]
        assert sum(one.incomplete for one in said) <= counters.get("missed", 0)


@pytest.mark.parametrize("death", ["SIGKILL", pytest.param("on command", marks=pytest.mark.study)])
def test_who_dies_in_real_time_is_back_on_command_and_agrees_at_once(tmp_path: Path, death: str):
    setup = small(nodes=5, graph="ring", steps=75)
    with playing(setup, tmp_path) as network:
        assert reaches(network, 20)
        pid = network.pids[str(STRUCK)]
        if death == "SIGKILL":
            os.kill(pid, signal.SIGKILL)
        else:
            say(network, f"kill {STRUCK}")
        assert holds_within(PATIENCE_S, lambda: not has_member(network, STRUCK))
        assert holds_within(PATIENCE_S, lambda: not lives(pid))
        assert reaches(network, 35)
        say(network, f"restart {STRUCK}")
        assert holds_within(PATIENCE_S, lambda: has_member(network, STRUCK))
    played = Played(setup, tmp_path, network.recorded())
    assert played.trace.steps == 75
    [gone] = played.step_of(Gone if death == "SIGKILL" else Left)
    [joined] = played.step_of(Joined)
    out = np.isnan(played.trace.mean[:, :, 0])
    assert set(np.flatnonzero(out[:, STRUCK])) == set(range(gone, joined))
    assert not np.delete(out, STRUCK, axis=1).any()
    if death == "SIGKILL":
        check_books(played, gone, joined)
    # A command does not change the clock: no reading comes before its time.
    assert all((one.heartbeat_late_s or 0.0) > -0.01 for one in played.told("timing"))
    # A late share was missed. A share that was sent before its node was back is late for no node.
    # After a kill on command no node misses the shares that the killed process still sends.
    rounds = setup.scenario.rounds
    unmissed = sum(gone * rounds <= cycle < joined * rounds for cycle in played.cycles_sent(STRUCK))
    for node, counters in enumerate(played.trace.counters):
        spare = unmissed if node in setup.neighbours[STRUCK] else 0
        assert counters.get("late", 0) <= counters.get("missed", 0) + spare
    usual = played.apart(STRUCK, 10, gone)
    first = joined + AGREES_CYCLES // setup.scenario.rounds
    # A busy machine takes shares and readings from anybody: then no more from it than from others.
    others = max(played.apart(node, first) for node in range(5) if node != STRUCK)
    assert played.apart(STRUCK, first) < 2 * max(usual, others), (usual, others, joined)


def contested(setup: Setup) -> dict[tuple[int, int], set[int]]:
    """Return the contenders for the dynamic slots of each group of a cycle that has such slots."""
    schedule, scenario = build_environment(setup).schedule, setup.scenario
    found = {}
    for cycle in range(scenario.steps * scenario.rounds):
        contenders = set(schedule.contenders(cycle)) - set(schedule.static_senders(cycle))
        for number, part in enumerate(schedule.groups(cycle)):
            if part.dynamic_slots and contenders:
                found[cycle, number] = contenders
    return found


def test_who_hangs_over_the_end_of_bids_gets_nothing_and_holds_up_nobody(tmp_path: Path):
    setup = small(schedule="hybrid", occupancy=0.5, steps=40)
    with playing(setup, tmp_path) as network:
        assert reaches(network, 10)
        pid = network.pids[str(STRUCK)]
        os.kill(pid, signal.SIGSTOP)
        time.sleep(HANG_S)
        os.kill(pid, signal.SIGCONT)
    played = Played(setup, tmp_path, network.recorded())
    contests, grants = contested(setup), played.told("grant")
    # The cycles go on: each has its one grant, in order, whichever nodes have sent bids.
    assert [(grant.cycle, grant.group) for grant in grants] == sorted(contests)
    unheard = {(g.cycle, g.group): set(g.unheard or ()) for g in grants}
    its_own = [key for key in sorted(contests) if STRUCK in contests[key]]
    # A busy machine may make it late elsewhere, but nowhere for so long.
    streaks = groupby(its_own, lambda key: STRUCK in unheard[key])
    without = max((list(keys) for is_without, keys in streaks if is_without), key=len)
    assert len(without) > 0.25 * HANG_S / slow_tempo(setup).cycle_s
    for grant in grants:
        missing = unheard[grant.cycle, grant.group]
        assert missing <= contests[grant.cycle, grant.group]
        assert not missing & set(grant.winners)
    # It asks for them when it moves again, and no process goes back for it.
    asked = {(bid.cycle, bid.group) for bid in played.told("bid") if bid.node == STRUCK}
    assert len(asked & set(without)) > 0.5 * len(without)
    assert any(STRUCK in grant.winners for grant in grants if grant.cycle > without[-1][0])
    assert played.figures.late_bids == sum(map(len, unheard.values()))
    said = played.told("estimate")
    delays_s = [one.age_s for one in said if one.node != STRUCK]
    # Held up they would be in one step of five.
    assert np.quantile(delays_s, 0.9) < HANG_S / 2
    assert not played.step_of(Gone)
    assert not np.isnan(np.delete(played.trace.mean, STRUCK, axis=1)).any()


def test_a_script_starts_a_process_at_its_step_and_time_does_not_wait_for_it(tmp_path: Path):
    setup = small(
        nodes=5, graph="ring", steps=50, changes=(f"8 kill {STRUCK}", f"15 restart {STRUCK}")
    )
    with playing(setup, tmp_path) as network:
        pass
    played = Played(setup, tmp_path, network.recorded())
    assert played.step_of(Left) == [8]
    [joined] = played.step_of(Joined)
    assert 15 < joined < 45
    out = np.isnan(played.trace.mean[:, :, 0])
    assert set(np.flatnonzero(out[:, STRUCK])) == set(range(8, joined))
    others = [one for one in played.told("estimate") if one.node != STRUCK]
    assert [one.step for one in others if one.node == 0] == list(range(50))
    # A wait would hold up both neighbours of the node, or all nodes, from the restart on. A busy
    # machine holds up single nodes, or all of them at any time.
    near = set(setup.neighbours[STRUCK])
    common_s = np.zeros(50)
    for nodes in (near, set(range(5)) - near - {STRUCK}):
        for step in range(50):
            told = [one.age_s for one in others if one.step == step and one.node in nodes]
            common_s[step] = max(common_s[step], min(told))
    usual_s = np.delete(common_s, np.s_[15 : joined + 1]).max()
    assert common_s[15 : joined + 1].max() < max(0.5, 2 * usual_s)


@pytest.mark.slow
def test_who_is_stopped_for_longer_than_the_lease_is_let_in_again_by_itself(tmp_path: Path):
    setup = small(steps=45, graph="ring")
    with playing(setup, tmp_path) as network:
        assert reaches(network, 5)
        pid = network.pids[str(STRUCK)]
        os.kill(pid, signal.SIGSTOP)
        time.sleep(2 * HANG_S)
        os.kill(pid, signal.SIGCONT)
    played = Played(setup, tmp_path, network.recorded())
    # On a busy machine it may stand still again.
    lives = zip_longest(played.step_of(Gone), played.step_of(Joined), fillvalue=45)
    away = {step for gone, joined in lives for step in range(gone, joined)}
    out = np.isnan(played.trace.mean[:, :, 0])
    assert away and set(np.flatnonzero(out[:, STRUCK])) == away
    assert played.step_of(Joined)
    assert not np.delete(out, STRUCK, axis=1).any()


def test_a_node_with_a_slow_processor_says_the_age_of_its_estimates(tmp_path: Path):
    """A step of it lasts longer than the time after which its estimate counts as lost."""
    setup = small(nodes=5, graph="ring", steps=80, changes=(f"10 slow-cpu {STRUCK} 10000",))
    tempo = tempo_of(setup, None)
    with playing(setup, tmp_path, tempo) as network:
        pass
    played = Played(setup, tmp_path, network.recorded(), tempo)
    ages_s = played.trace.estimate_age_s
    assert ages_s is not None
    # In healthy steps, and in those in which it has just entered again, its age is known.
    assert np.nanmax(ages_s) <= tempo.oldest_s
    assert np.isfinite(ages_s[:10, STRUCK]).any()
    assert np.isfinite(ages_s[20:, STRUCK]).mean() < 0.5
    others = np.delete(ages_s, STRUCK, axis=1)
    assert np.isfinite(others).mean() > 0.9
    assert np.isfinite(others[20:]).mean() > 2 * np.isfinite(ages_s[20:, STRUCK]).mean()
    assert played.figures.delay.largest_ms <= played.figures.delay_limit_ms


def test_who_falls_far_behind_skips_ahead_and_estimates_the_present(tmp_path: Path):
    """It stands still for 3 s, and an estimate counts as lost after 2.6 s."""
    setup = small(nodes=5, graph="ring", steps=80)
    tempo = tempo_of(setup, None)
    with playing(setup, tmp_path, tempo) as network:
        assert reaches(network, 10)
        pid = network.pids[str(STRUCK)]
        os.kill(pid, signal.SIGSTOP)
        time.sleep(2 * HANG_S)
        os.kill(pid, signal.SIGCONT)
    assert tempo.timeout_steps * tempo.step_s < 2 * HANG_S
    played = Played(setup, tmp_path, network.recorded(), tempo)
    assert played.figures.skips >= 1
    first = played.step_of(Gone)[0]
    [joined, *_] = [step for step in played.step_of(Joined) if step > first]
    # It takes no part in the steps between, and works off none of them.
    assert joined - first > 5
    said = {one.step for one in played.told("timing") if one.node == STRUCK}
    assert not said & set(range(first + 2, joined))
    assert not np.isnan(played.trace.mean[joined, STRUCK]).any()
