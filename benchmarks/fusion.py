"""Covariance intersection over a whole network: a round beside a loop over nodes, and many rounds.

With fixed weights the rounds of a step stay in information form: the beliefs are turned into
numbers once, mixed, and turned back once.
"""

import time
from collections.abc import Callable

import numpy as np

from benchmarks.measure import Figures, figure, in_turns, median_us, ratio, say, without_kernels
from filters import compiled
from filters.fusion import INFORMATION
from filters.gaussian import Gaussian
from filters.packed import mix
from topology.geometric_graphs import connecting_radius, geometric, scatter
from topology.weights import metropolis

# Runs are taken as many at a time as fit into the caches.
NODES, RUNS, BLOCK, STATES, TURNS, LOOP_RUNS = 20, 500, 100, 4, 15, 5


def network(runs: int, nodes: int, states: int) -> tuple[Gaussian, np.ndarray]:
    """Beliefs (runs, nodes, n), as the filters leave them, and Metropolis weights (nodes, nodes) of
    a random geometric graph."""
    generator = np.random.default_rng(1)
    radius = 1.5 * connecting_radius(nodes)
    weights = metropolis(geometric(scatter(nodes, 1, radius), radius)).toarray()
    root = generator.standard_normal((states, states + 2, runs, nodes))
    cov = np.einsum("iklm,jklm->ijlm", root, root)
    mean = generator.standard_normal((states, runs, nodes))
    return Gaussian(mean.transpose(1, 2, 0), cov.transpose(2, 3, 0, 1)), weights


def fuse(beliefs: Gaussian, weights: np.ndarray, rounds: int) -> Gaussian:
    """What all nodes believe after rounds with fixed weights."""
    origin = beliefs.mean.mean(axis=-2, keepdims=True)
    return INFORMATION.conclude(mix(INFORMATION.express(beliefs, origin), weights, rounds), origin)


def loop(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """The same round node by node, every node over those it hears."""
    mean, cov = np.empty(beliefs.mean.shape), np.empty(beliefs.cov.shape)
    states = beliefs.mean.shape[-1]
    heard = [np.flatnonzero(row).tolist() for row in weights]
    for run in range(len(mean)):
        matrices = [np.linalg.inv(one) for one in beliefs.cov[run]]
        vectors = [m @ x for m, x in zip(matrices, beliefs.mean[run], strict=True)]
        for node, others in enumerate(heard):
            matrix, vector = np.zeros((states, states)), np.zeros(states)
            for other in others:
                weight = weights[node, other]
                matrix += weight * matrices[other]
                vector += weight * vectors[other]
            cov[run, node] = np.linalg.inv(matrix)
            mean[run, node] = cov[run, node] @ vector
    return Gaussian(mean, cov)


def timed(run: Callable[[], object], node_rounds: int) -> Callable[[], float]:
    """Seconds of the processor per node and round."""

    def once() -> float:
        started = time.thread_time()
        run()
        return (time.thread_time() - started) / node_rounds

    return once


def main() -> Figures:
    """Print and return node-rounds per second and ratios."""
    beliefs, weights = network(BLOCK, NODES, STATES)
    few = Gaussian(*(np.ascontiguousarray(part[:LOOP_RUNS]) for part in beliefs))
    for array, expected in zip(fuse(few, weights, 1), loop(few, weights), strict=True):
        np.testing.assert_allclose(array, expected, rtol=1e-9, atol=1e-11)

    def ours(rounds: int) -> Callable[[], float]:
        def all_blocks() -> None:
            for _ in range(RUNS // BLOCK):
                fuse(beliefs, weights, rounds)

        return timed(all_blocks, NODES * RUNS)

    contestants = {
        "loop": timed(lambda: loop(few, weights), NODES * LOOP_RUNS),
        "numpy, 1 round": without_kernels(ours(1)),
        "numpy, 5 rounds": without_kernels(ours(5)),
    }
    if compiled.KERNELS is not None:
        contestants["compiled, 1 round"] = ours(1)
        contestants["compiled, 5 rounds"] = ours(5)
    given = in_turns(contestants, TURNS)
    say(f"fusion, covariance intersection, {NODES} nodes x {RUNS} runs, n = {STATES}")
    results: Figures = {}
    for name, spent in given.items():
        beside = ratio(given["loop"], spent)
        say(
            f"  {name:<20}{median_us(spent):>9.3f} us per node{beside.value:>9.1f} x the loop "
            f"({beside.low:.1f} - {beside.high:.1f})"
        )
        results[f"{name} us"] = figure([1e6 * one for one in spent], "us/node", "less")
        results[f"{name} x loop"] = beside
    for kind in ("numpy", "compiled"):
        if f"{kind}, 5 rounds" in given:
            pairs = zip(given[f"{kind}, 5 rounds"], given[f"{kind}, 1 round"], strict=True)
            cost = figure([five / one for five, one in pairs], "x", "less")
            results[f"{kind}, five rounds over one"] = cost
            say(
                f"  {kind}: five rounds cost {cost.value:.2f} x one "
                f"({cost.low:.2f} - {cost.high:.2f})"
            )
    return results


if __name__ == "__main__":
    main()
