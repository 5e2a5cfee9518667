"""Lockstep rate of a network beside its floor, in the same run, and what each process takes of it.

The floor (`benchmarks/bare_loop.py`) is a loop of the same processes that makes the same filter
calls: once with the same messages, made and read, once with as many bytes that say nothing.

Processor time per step is that of all processes together: a long run less a short one, so that
starting up is left out. It wavers less than the rate where others use the machine too.
"""

import resource
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.bare_loop import Load
from benchmarks.measure import FULL_BUS, BenchmarkFigures, figure, ratio, say
from concord.nodes.messages import decode, from_wire
from concord.runtime.drivers import in_memory, over_processes
from concord.runtime.interpreter import fresh_command, fresh_variables
from concord.scenarios.build import OPEN_LOOP_LEAD
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup

NODES, GRAPH, STEPS, SHORT_STEPS, REPETITIONS = 16, "4-regular", 300, 50, 5


Run = Callable[[], float]


class LockstepPace(NamedTuple):
    """Steps per second, and seconds of all processors per step."""

    steps_per_second: float
    processor_s: float


def main() -> BenchmarkFigures:
    """Print and return rates, processor times and their ratios."""
    setup, short = (setup_of(steps) for steps in (STEPS, SHORT_STEPS))
    traffic = traffic_of(in_memory(short))
    contestants: dict[str, tuple[Run, Run]] = {
        "lockstep": (partial(lockstep_rate, setup), partial(lockstep_rate, short)),
        "bare": (
            partial(floor_rate, load_of(setup, traffic)),
            partial(floor_rate, load_of(short, traffic)),
        ),
        "bare bytes": (
            partial(floor_rate, load_of(setup, traffic, says=False)),
            partial(floor_rate, load_of(short, traffic, says=False)),
        ),
    }
    paces: dict[str, list[LockstepPace]] = {name: [] for name in contestants}
    for _ in range(REPETITIONS):
        for name, runs in contestants.items():
            paces[name].append(pace_of(*runs))
    rates = {name: [one.steps_per_second for one in turns] for name, turns in paces.items()}
    spent = {name: [1e3 * one.processor_s for one in turns] for name, turns in paces.items()}
    say(
        f"lockstep, {NODES} nodes, {GRAPH}, {setup.scenario.rounds} rounds, beside bare loops with "
        f"the same filter calls, {REPETITIONS} turns"
    )
    results: BenchmarkFigures = {}
    for name in contestants:
        label = "" if name == "lockstep" else f"{name} "
        rate = results[f"{label}steps per second"] = figure(rates[name], "1/s", "more")
        cost = results[f"{label}processor ms per step"] = figure(spent[name], "ms", "less")
        say(f"  {name:<20}{rate.value:6.0f} steps per second, {cost.value:6.1f} processor ms each")
    for name, of in (("bare", "with the same messages"), ("bare bytes", "of bytes alone")):
        by_rate = results[f"lockstep over {name}"] = ratio(rates["lockstep"], rates[name])
        by_cost = ratio(spent[name], spent["lockstep"])
        results[f"lockstep over {name}, by processor time"] = by_cost
        say(
            f"  beside the loop {of}: {by_rate.value:.2f} ({by_rate.low:.2f} - {by_rate.high:.2f}) "
            f"of its rate, {by_cost.value:.2f} ({by_cost.low:.2f} - {by_cost.high:.2f}) by "
            "processor time"
        )
    return results


def setup_of(steps: int) -> Setup:
    """Return the network that is measured."""
    return prepare(scenario_of(nodes=NODES, graph=GRAPH, steps=steps, seed=1, **FULL_BUS))


def pace_of(run: Run, shorter: Run) -> LockstepPace:
    """Return the rate of a run, and what each of its steps takes of the processor."""
    before_s = _children_s()
    shorter()
    between_s = _children_s()
    rate = run()
    spent_s = (_children_s() - between_s) - (between_s - before_s)
    return LockstepPace(rate, spent_s / (STEPS - SHORT_STEPS))


def _children_s() -> float:
    """Processor time of all processes that we have started and that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def lockstep_rate(setup: Setup) -> float:
    """Return the steps per second of a network over processes."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.mcap"
        pace = over_processes(setup, Path(folder).name, recording, None, lambda _: None)
        return pace.steps_per_second or 0.0


class MessageTraffic(NamedTuple):
    """The largest message of each kind, and in which part of its steps a node sees something."""

    sizes: dict[str, int]
    sees: float


def traffic_of(messages: Sequence[tuple[str, bytes]]) -> MessageTraffic:
    """Return the traffic of a run."""
    sizes: dict[str, int] = {}
    seen: list[bool] = []
    for topic, data in messages:
        kind = topic.partition("/")[0]
        sizes[kind] = max(sizes.get(kind, 0), len(data))
        if kind == "measured":
            readings = from_wire(decode(topic, data).readings)
            seen.append(not np.isnan(readings).all())
    return MessageTraffic(sizes, sum(seen) / len(seen))


def load_of(setup: Setup, traffic: MessageTraffic, says: bool = True) -> Load:
    """Return the same for a bare loop."""
    sizes = traffic.sizes
    return Load(
        setup.neighbours,
        setup.scenario.rounds,
        setup.scenario.steps,
        OPEN_LOOP_LEAD,
        traffic.sees,
        says,
        sizes["measured"],
        sizes["share"],
        sizes["estimate"],
    )


def floor_rate(load: Load) -> float:
    """Return the steps per second of a bare loop."""
    process = subprocess.Popen(
        fresh_command("benchmarks.bare_loop"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=fresh_variables(OPENBLAS_NUM_THREADS="1"),
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
