"""How a run kept its time, beside what an onlooker with a clock of its own saw of it."""

import os
import signal
import time
from math import ceil, floor
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import cycle_of
from concord.nodes.messages import Estimate, Timing, decode, encode, topic
from concord.nodes.tempo import Tempo
from concord.results.figures.timing_figures import figures_of
from concord.runtime.processes.clock import EnvironmentClock
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from tests.experiments.support import small, trace_of
from tests.laboratory.running import Running
from tests.processes import PATIENCE_S, PROC, holds_within

# It looks on up to this step, and leaves before the end.
STEPS, LAST = 20, 15
# With cycles of 100 ms a busy machine delays an onlooker by less than half a cycle.
SLOWER, STOP_S = 5, 1.5
LATE_S = st.floats(-0.01, 0.2)


@given(st.lists(st.tuples(LATE_S, st.lists(LATE_S, min_size=1, max_size=4)), min_size=1))
def test_spreads_lie_at_their_ranks(steps: list[tuple[float, list[float]]]):
    """Between the values at the ranks next to p of all, counted by hand."""
    said = [Timing(0, k, 0.0, cycles, 0, 0) for k, (_, cycles) in enumerate(steps)]
    sent_s = np.array([[delay] for delay, _ in steps])
    messages = [(topic(one), encode(one)) for one in said]
    figures = figures_of(Tempo(1.0, 0.02, 0.1), messages, [{}], sent_s)
    jitter = sorted(1e3 * late for _, cycles in steps for late in cycles)
    delays = sorted(1e3 * delay for delay, _ in steps)
    assert figures.cycles == len(jitter)
    for spread, values in ((figures.cycle_jitter, jitter), (figures.delay, delays)):
        for p, told in ((0.5, spread.p50_ms), (0.99, spread.p99_ms), (1.0, spread.largest_ms)):
            rank = p * (len(values) - 1)
            assert values[floor(rank)] - 1e-9 <= told <= values[ceil(rank)] + 1e-9


class Onlooker:
    """When each frame and each estimate was heard after the common start, by a clock of its own."""

    def __init__(self, network: Running) -> None:
        self.frames_s: dict[tuple[int, int], float] = {}
        self.estimates_s: dict[tuple[int, int], float] = {}
        answer = network.client._transport.ask("clock")
        assert answer is not None
        start_s = msgspec.json.decode(answer, type=EnvironmentClock).start_s
        assert start_s is not None
        self._start_s = start_s
        network.client.listen("share/*", self._hear_share)
        network.client.listen("estimate/*", self._hear_estimate)

    def _hear_share(self, name: str, data: bytes) -> None:
        key = int(name.partition("/")[2]), cycle_of(data)
        self.frames_s.setdefault(key, time.monotonic() - self._start_s)

    def _hear_estimate(self, name: str, data: bytes) -> None:
        said: Estimate = decode(name, data)
        self.estimates_s[said.node, said.step] = time.monotonic() - self._start_s


def watched(setup: Setup, folder: Path, stopped: int, tempo: Tempo) -> tuple[Running, Onlooker]:
    """A run in real time in which a node is stopped for a while, to its end."""
    network = Running(setup, "realtime", folder, tempo=tempo)
    try:
        onlooker = Onlooker(network)
        assert holds_within(PATIENCE_S, lambda: network.client.state()["completed"] >= 4)
        pid = network.pids[str(stopped)]
        os.kill(pid, signal.SIGSTOP)
        time.sleep(STOP_S)
        os.kill(pid, signal.SIGCONT)
        whole = {(node, LAST) for node in range(setup.scenario.nodes)}
        assert holds_within(PATIENCE_S, lambda: whole <= set(onlooker.estimates_s))
    finally:
        network.end()
    return network, onlooker


@pytest.mark.zenoh
@pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there")
def test_what_nodes_say_of_their_time_is_what_an_onlooker_sees(tmp_path: Path):
    setup = small(graph="ring", steps=STEPS)
    rounds, stopped = setup.scenario.rounds, 1
    tempo = tempo_of(setup, SLOWER * tempo_of(setup, None).stretch)
    network, onlooker = watched(setup, tmp_path, stopped, tempo)
    messages = network.recorded()
    said = {
        (one.node, one.step): one
        for one in (decode(t, data) for t, data in messages if t.startswith("timing/"))
    }
    trace = trace_of(setup, tmp_path / "run.mcap")
    ends, sent_s = trace.counters, trace.estimate_age_s
    assert sent_s is not None
    figures = figures_of(tempo, messages, ends, sent_s)

    # Each estimate is heard after it was sent, mostly within a few milliseconds.
    behind_s = [
        heard_s - step * tempo.step_s - sent_s[step, node]
        for (node, step), heard_s in onlooker.estimates_s.items()
    ]
    assert min(behind_s) > 0
    assert np.median(behind_s) < tempo.cycle_s / 2
    begin_s = {
        (node, cycle): cycle // rounds * tempo.step_s + cycle % rounds * tempo.cycle_s
        for node, cycle in onlooker.frames_s
    }
    late_s = {key: heard_s - begin_s[key] for key, heard_s in onlooker.frames_s.items()}
    apart_s = [
        late - said[node, cycle // rounds].cycle_late_s[cycle % rounds]
        for (node, cycle), late in late_s.items()
    ]
    assert np.median(np.abs(apart_s)) < tempo.cycle_s / 2

    # A receiver misses a frame that arrives after its cycle, unless the receiver is late itself.
    # The margin of half a cycle allows for the delays of both links.
    margin_s, cycles = tempo.cycle_s / 2, (LAST + 1) * rounds
    estimates = [decode(t, data) for t, data in messages if t.startswith("estimate/")]
    counted = {one.node: one.counters for one in estimates if one.step == LAST}
    for receiver in setup.neighbours[stopped]:
        mine = [said[receiver, step] for step in range(LAST + 1)]
        own = 2 * sum(late > margin_s for one in mine for late in one.cycle_late_s)
        heard = set(setup.neighbours[receiver])
        frames = [late_s[key] for key in late_s if key[0] in heard and key[1] < cycles]
        least = sum(late > tempo.cycle_s + margin_s for late in frames)
        most = sum(late > tempo.cycle_s - margin_s for late in frames)
        missed, late = counted[receiver]["missed"], counted[receiver]["late"]
        assert least > 6
        assert least - own <= missed <= most + own
        assert least - own <= late <= most + own
        assert sum(one.incomplete for one in mine) <= missed
        assert missed <= 2 * sum(one.incomplete + one.overrun for one in mine)
    assert figures.late_shares == sum(one.get("late", 0) for one in ends)
    # The onlooker hears no cycle before its end that the stopped node began after its end. Frames
    # that follow each other at once may get lost.
    mine = [said[stopped, step] for step in range(LAST + 1)]
    told = {
        (stopped, step * rounds + number)
        for step, one in enumerate(mine)
        for number, late in enumerate(one.cycle_late_s)
        if late >= tempo.cycle_s
    }
    assert len(told) == sum(one.overrun for one in mine)
    heard_s = [late_s[key] for key in told & set(late_s)]
    assert len(heard_s) > 6
    assert min(heard_s) > tempo.cycle_s - margin_s
