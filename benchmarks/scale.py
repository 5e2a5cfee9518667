"""Cost of a step as the network grows, at a constant number of lanes.

The sizes are ten to ten thousand nodes and, for a thousand nodes, two thousand to thirty-two
thousand edges. `simulate` runs regular networks. The number of runs is chosen to fill the lanes, so
the arrays have one size and only the size of the network varies.
"""

import time
from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.measure import (
    FULL_BUS,
    BenchmarkFigure,
    BenchmarkFigures,
    figure,
    in_turns,
    peak_mb,
    say,
)
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate

LANES, STEPS, TURNS = 10_000, 8, 5
SIZES, DEGREE = (10, 100, 1_000, 10_000), 4
NODES, DEGREES = 1_000, (4, 16, 64)

Spent = Mapping[int, list[float]]


def main() -> BenchmarkFigures:
    """Print and return what an edge costs, how the cost grows with nodes and with edges, and what
    an edge of 10,000 nodes costs over one of 100."""
    networks = [(nodes, DEGREE) for nodes in SIZES] + [(NODES, degree) for degree in DEGREES[1:]]
    given = in_turns({f"{n} {d}": _timed(n, d) for n, d in networks}, TURNS)
    by_nodes = {nodes: given[f"{nodes} {DEGREE}"] for nodes in SIZES}
    by_edges = {NODES * degree // 2: given[f"{NODES} {degree}"] for degree in DEGREES}
    results: BenchmarkFigures = {}
    say(f"cost against nodes, {DEGREE}-regular, {LANES} lanes, per edge, run and round")
    for nodes, spent in by_nodes.items():
        edges = nodes * DEGREE // 2
        results[f"{nodes} nodes, ns per edge"] = _per_edge(f"{nodes} nodes, {edges}", spent, edges)
    pairs = zip(by_nodes[10_000], by_nodes[100], strict=True)
    growth = figure([large / small / 100 for large, small in pairs], "x", "less")
    results["10000 over 100 nodes"] = growth
    results["slope over nodes"] = _slope(by_nodes)
    say(
        f"  grows as nodes to the {results['slope over nodes'].value:.2f}; per edge 10,000 nodes "
        f"cost {growth.value:.2f} x 100 nodes ({growth.low:.2f} - {growth.high:.2f})"
    )
    say(f"cost against edges, {NODES} nodes")
    for edges, spent in by_edges.items():
        results[f"{edges} edges, ns per edge"] = _per_edge(f"{NODES} nodes, {edges}", spent, edges)
    results["slope over edges"] = _slope(by_edges)
    turns = np.array(list(by_edges.values())).T
    further = [1e9 * float(np.polyfit(list(by_edges), costs, 1)[0]) for costs in turns]
    results["a further edge ns"] = figure(further, "ns", "less")
    say(
        f"  grows as edges to the {results['slope over edges'].value:.2f}, as the filters cost the "
        f"same; a further edge costs {results['a further edge ns'].value:.0f} ns; "
        f"peak {peak_mb():.0f} MB"
    )
    return results


def _per_edge(name: str, spent: list[float], edges: int) -> BenchmarkFigure:
    cost = figure([1e9 * one / edges for one in spent], "ns", "less")
    say(f"  {name:>20} edges: {cost.value:8.0f} ns ({cost.low:.0f} - {cost.high:.0f})")
    return cost


def _slope(spent: Spent) -> BenchmarkFigure:
    """Return the power of the size that the cost grows with."""
    costs = np.array(list(spent.values())).T
    return figure(
        [float(np.polyfit(np.log(list(spent)), np.log(c), 1)[0]) for c in costs], "", "less"
    )


def _timed(nodes: int, degree: int) -> Callable[[], float]:
    """Seconds of the processor for a network, per run and round."""
    network = FULL_BUS | {"nodes": nodes, "graph": f"{degree}-regular", "bus": "ideal"}
    options = scenario_of(steps=STEPS, seed=1, **network)
    setup: Setup = prepare(options)
    runs = range(LANES // nodes)
    work = len(runs) * STEPS * setup.scenario.rounds

    def once() -> float:
        started = time.thread_time()
        simulate(setup, runs, keep=())
        return (time.thread_time() - started) / work

    return once


if __name__ == "__main__":
    main()
