"""Lockstep rate of a network beside the bare loop with the same messages, in the same run.

Processor time per step is that of all processes together: a long run less a short one, so that
starting up is left out. It wavers less than the rate where others use the machine too.
"""

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec

from benchmarks.bare_loop import Load
from benchmarks.measure import Figures, figure, ratio, say
from experiments.drivers import over_processes
from experiments.options import ScenarioOptions
from nodes.recording import read_recording
from scenarios.build import OPEN_LOOP_LEAD
from scenarios.setup import Setup, prepare

NODES, GRAPH, STEPS, SHORT_STEPS, REPETITIONS = 16, "4-regular", 300, 50, 5


class Pace(NamedTuple):
    """Steps per second, and seconds of all processors per step."""

    steps_per_second: float
    processor_s: float


def main() -> Figures:
    """Print and return rates, processor times and their ratios."""
    setup, short = (_setup(steps) for steps in (STEPS, SHORT_STEPS))
    sizes = _sizes(short)
    load, short_load = (_load(one, sizes) for one in (setup, short))
    ours: list[Pace] = []
    bare: list[Pace] = []
    for _ in range(REPETITIONS):
        ours.append(_pace(lambda: _lockstep(setup), lambda: _lockstep(short)))
        bare.append(_pace(lambda: _floor(load), lambda: _floor(short_load)))
    rates, floors = ([one.steps_per_second for one in side] for side in (ours, bare))
    spent, spent_bare = ([1e3 * one.processor_s for one in side] for side in (ours, bare))
    results = {
        "steps per second": figure(rates, "1/s", "more"),
        "bare steps per second": figure(floors, "1/s", "more"),
        "lockstep over bare": ratio(rates, floors),
        "processor ms per step": figure(spent, "ms", "less"),
        "bare processor ms per step": figure(spent_bare, "ms", "less"),
        "lockstep over bare, by processor time": ratio(spent_bare, spent),
    }
    rate, floor, over, cost, least, by_cost = results.values()
    say(
        f"lockstep, {NODES} nodes, {GRAPH}, {setup.scenario.rounds} rounds, beside a bare loop "
        f"with the same messages and filter calls, {REPETITIONS} turns\n"
        f"  steps per second      {rate.value:6.0f} and {floor.value:6.0f}: ratio "
        f"{over.value:.2f} ({over.low:.2f} - {over.high:.2f})\n"
        f"  processor ms per step {cost.value:6.1f} and {least.value:6.1f}: ratio "
        f"{by_cost.value:.2f} ({by_cost.low:.2f} - {by_cost.high:.2f})"
    )
    return results


def _setup(steps: int) -> Setup:
    return prepare(ScenarioOptions(nodes=NODES, graph=GRAPH, steps=steps, seed=1).resolve())


def _pace(run: Callable[[], float], shorter: Callable[[], float]) -> Pace:
    """The rate of a run, and what each of its steps takes of the processor."""
    before_s = _children_s()
    shorter()
    between_s = _children_s()
    rate = run()
    spent_s = (_children_s() - between_s) - (between_s - before_s)
    return Pace(rate, spent_s / (STEPS - SHORT_STEPS))


def _children_s() -> float:
    """Processor time of all processes that we have started and that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _lockstep(setup: Setup) -> float:
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.mcap"
        pace = over_processes(setup, Path(folder).name, recording, None, lambda _: None)
        return pace.steps_per_second or 0.0


def _sizes(setup: Setup) -> dict[str, int]:
    """The largest message of each kind that a run sends."""
    sizes: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.mcap"
        over_processes(setup, Path(folder).name, recording, None, lambda _: None)
        for topic, data in read_recording(recording):
            kind = topic.partition("/")[0]
            sizes[kind] = max(sizes.get(kind, 0), len(data))
    return sizes


def _load(setup: Setup, sizes: dict[str, int]) -> Load:
    return Load(
        setup.neighbours,
        setup.scenario.rounds,
        setup.scenario.steps,
        OPEN_LOOP_LEAD,
        sizes["measured"],
        sizes["share"],
        sizes["estimate"],
    )


def _floor(load: Load) -> float:
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.bare_loop"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    assert process.stdin is not None and process.stdout is not None
    with process:
        process.stdin.write(msgspec.json.encode(load) + b"\n")
        process.stdin.flush()
        answer = msgspec.json.decode(process.stdout.readline())
        process.stdin.close()
    return answer["steps_per_second"]


if __name__ == "__main__":
    main()
