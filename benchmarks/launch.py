"""How long until a network of processes is ready, and what a node weighs."""

import statistics
import sys
import tempfile
from pathlib import Path

from benchmarks.measure import BenchmarkFigures, figure
from concord.runtime.processes.job import Happened
from concord.runtime.processes.launcher import run_processes
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup

# As many steps as let every process be weighed before the first one leaves.
STEPS = 80
SIZES, REPETITIONS, GRAPH = (4, 16, 64), 3, "4-regular"


def main() -> BenchmarkFigures:
    """Print and return, per network size, seconds to ready and proportional memory per node."""
    results: BenchmarkFigures = {}
    for nodes in SIZES:
        graph = "complete" if nodes < 5 else GRAPH
        options = scenario_of(scenario="oscillator", nodes=nodes, graph=graph, steps=STEPS)
        setup = prepare(options)
        ready, memory = zip(*(_launch(setup) for _ in range(REPETITIONS)), strict=True)
        results[f"{nodes} nodes ready s"] = figure(list(ready), "s", "less")
        results[f"{nodes} nodes MB per node"] = figure(list(memory), "MB", "less")
        sys.stdout.write(
            f"launch, {nodes} nodes, {graph}: ready after {statistics.median(ready):.2f} s "
            f"({min(ready):.2f} to {max(ready):.2f}), {statistics.median(memory):.1f} MB "
            "proportional per node\n"
        )
    return results


def _launch(setup: Setup) -> tuple[float, float]:
    """Seconds until the network is ready, and MB per node then."""
    pids: dict[str, int] = {}
    seen: list[tuple[float, float]] = []

    def on_event(happened: Happened) -> None:
        pids.update(happened.pids)
        if happened.what == "ready":
            seen.append((happened.seconds, _proportional_mb(pids)))

    with tempfile.TemporaryDirectory() as folder:
        run_processes(setup, Path(folder).name, Path(folder) / "run.mcap", None, on_event)
    return seen[0]


def _proportional_mb(pids: dict[str, int]) -> float:
    """Mean proportional set size of the node processes (Linux)."""
    sizes = []
    for name, pid in pids.items():
        if name.isdigit():
            lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
            pss = next(line for line in lines if line.startswith("Pss:"))
            sizes.append(int(pss.split()[1]) / 1024)
    return statistics.mean(sizes)


if __name__ == "__main__":
    main()
