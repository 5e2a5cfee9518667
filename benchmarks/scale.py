"""What a step costs as the network grows: ten to ten thousand nodes, the same number of lanes.

`experiments.vectorised.simulate` runs 4-regular networks; runs are as many as make up the lanes, so
that what is compared is the size of the network and not that of the arrays.
"""

import time
from collections.abc import Callable

import numpy as np

from benchmarks.measure import Figures, figure, in_turns, peak_mb, say
from experiments.options import ScenarioOptions
from experiments.vectorised import simulate
from scenarios.setup import Setup, prepare

SIZES, DEGREE, LANES, STEPS, TURNS = (10, 100, 1_000, 10_000), 4, 10_000, 8, 5


def main() -> Figures:
    """Print and return the cost per edge, its slope, and that of 10,000 nodes over that of 100."""
    given = in_turns({str(nodes): _timed(nodes) for nodes in SIZES}, TURNS)
    say(f"cost against size, {DEGREE}-regular, {LANES} lanes, per edge, run and round")
    results: Figures = {}
    for name, spent in given.items():
        cost = figure([1e9 * one for one in spent], "ns", "less")
        results[f"{name} nodes, ns per edge"] = cost
        edges = int(name) * DEGREE // 2
        say(
            f"  {name:>6} nodes, {edges:>6} edges: {cost.value:8.0f} ns "
            f"({cost.low:.0f} - {cost.high:.0f})"
        )
    pairs = zip(given["10000"], given["100"], strict=True)
    growth = figure([large / small for large, small in pairs], "x", "less")
    results["10000 over 100 nodes"] = growth
    medians = [results[f"{nodes} nodes, ns per edge"].value * nodes for nodes in SIZES]
    slope = float(np.polyfit(np.log(SIZES), np.log(medians), 1)[0])
    results["slope"] = figure([slope], "", "less")
    say(
        f"  cost grows as nodes to the {slope:.2f}; per edge 10,000 nodes cost "
        f"{growth.value:.2f} x 100 nodes ({growth.low:.2f} - {growth.high:.2f}); "
        f"peak {peak_mb():.0f} MB"
    )
    return results


def _timed(nodes: int) -> Callable[[], float]:
    options = ScenarioOptions(
        nodes=nodes, graph=f"{DEGREE}-regular", steps=STEPS, seed=1, cluster="none"
    )
    setup: Setup = prepare(options.resolve())
    runs = range(LANES // nodes)
    work = len(runs) * nodes * DEGREE // 2 * STEPS * setup.scenario.rounds

    def once() -> float:
        started = time.thread_time()
        simulate(setup, runs, keep=())
        return (time.thread_time() - started) / work

    return once


if __name__ == "__main__":
    main()
