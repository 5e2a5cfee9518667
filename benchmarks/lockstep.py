"""Lockstep rate of a network beside the bare loop with the same messages, in the same run."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import msgspec

from benchmarks.bare_loop import Load
from benchmarks.measure import Figures, figure, ratio, say
from experiments.drivers import over_processes
from experiments.options import ScenarioOptions
from nodes.recording import read_recording
from scenarios.build import OPEN_LOOP_LEAD
from scenarios.setup import Setup, prepare

NODES, GRAPH, STEPS, REPETITIONS = 16, "4-regular", 300, 5


def main() -> Figures:
    """Print and return both rates and their ratio."""
    options = ScenarioOptions(nodes=NODES, graph=GRAPH, steps=STEPS, seed=1)
    setup = prepare(options.resolve())
    rates, floors = [], []
    sizes: dict[str, int] = {}
    for _ in range(REPETITIONS):
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "run.mcap"
            pace = over_processes(setup, Path(folder).name, recording, None, lambda _: None)
            rates.append(pace.steps_per_second or 0.0)
            sizes = sizes or _sizes(recording)
        floors.append(_floor(setup, sizes))
    results = {
        "steps per second": figure(rates, "1/s", "more"),
        "bare steps per second": figure(floors, "1/s", "more"),
        "lockstep over bare": ratio(rates, floors),
    }
    rate, bare, over = results.values()
    rounds = setup.scenario.rounds
    say(
        f"lockstep, {NODES} nodes, {GRAPH}, {rounds} rounds: {rate.value:.0f} steps/s, "
        f"{rate.value * rounds:.0f} cycles/s; bare loop with the same messages and filter calls "
        f"{bare.value:.0f} steps/s; ratio {over.value:.2f} ({over.low:.2f} - {over.high:.2f}, "
        f"{REPETITIONS} interleaved)"
    )
    return results


def _sizes(recording: Path) -> dict[str, int]:
    """The largest message of each kind in a recording."""
    sizes: dict[str, int] = {}
    for topic, data in read_recording(recording):
        kind = topic.partition("/")[0]
        sizes[kind] = max(sizes.get(kind, 0), len(data))
    return sizes


def _floor(setup: Setup, sizes: dict[str, int]) -> float:
    load = Load(
        setup.neighbours,
        setup.scenario.rounds,
        setup.scenario.steps,
        OPEN_LOOP_LEAD,
        sizes["measured"],
        sizes["share"],
        sizes["estimate"],
    )
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
