"""Covariance intersection over a whole network: a round beside a loop over nodes, and many rounds.

What is timed is what the vectorised driver does between the readings of a step and its estimates:
the rounds of the fleet that a scenario builds. Where beliefs weigh alike however sharp they are,
the fleet takes all rounds as one product; else it looks at their sharpness after every round.
"""

import time
from collections.abc import Callable

import numpy as np

from benchmarks.measure import Figures, figure, in_turns, median_us, ratio, say, without_kernels
from experiments.options import ScenarioOptions
from filters import compiled
from filters.gaussian import Gaussian
from nodes.vectorised_network import Fleet
from scenarios.setup import Setup, prepare
from scenarios.vectorised import build_network

NODES, RUNS, TURNS, LOOP_RUNS, MANY, REPEATS = 20, 500, 15, 5, 5, 5
SCENARIO = "target-crossing"  # four states, on a geometric graph


def network(rounds: int, by_sharpness: bool) -> tuple[Setup, Fleet]:
    """The network of a scenario, and its rule at all nodes of all runs."""
    options = ScenarioOptions(
        scenario=SCENARIO, nodes=NODES, rounds=rounds, determinant_weights=by_sharpness, seed=1
    )
    setup = prepare(options.resolve())
    return setup, build_network(setup, range(RUNS)).eras[0].regime.fleet


def beliefs(states: int) -> Gaussian:
    """Beliefs (runs, nodes, n), as the filters leave them."""
    generator = np.random.default_rng(1)
    root = generator.standard_normal((states, states + 2, RUNS, NODES))
    cov = np.einsum("iklm,jklm->ijlm", root, root)
    mean = generator.standard_normal((states, RUNS, NODES))
    return Gaussian(mean.transpose(1, 2, 0), cov.transpose(2, 3, 0, 1))


def fuse(fleet: Fleet, given: Gaussian, rounds: int) -> Gaussian:
    """What all nodes believe after so many rounds in which everybody is heard."""
    content, everybody = fleet.start(given), np.ones(given.mean.shape[:2], dtype=bool)
    for _ in range(rounds):
        content = fleet.exchange(content, everybody, None)
    return fleet.belief(content)


def loop(given: Gaussian, setup: Setup) -> Gaussian:
    """A round node by node, every node over those it hears."""
    mean, cov = np.empty(given.mean.shape), np.empty(given.cov.shape)
    states = given.mean.shape[-1]
    heard = [[node, *others] for node, others in enumerate(setup.neighbours)]
    for run in range(len(mean)):
        matrices = [np.linalg.inv(one) for one in given.cov[run]]
        vectors = [m @ x for m, x in zip(matrices, given.mean[run], strict=True)]
        for node, (others, weights) in enumerate(zip(heard, setup.weights, strict=True)):
            matrix, vector = np.zeros((states, states)), np.zeros(states)
            for other, weight in zip(others, weights, strict=True):
                matrix += weight * matrices[other]
                vector += weight * vectors[other]
            cov[run, node] = np.linalg.inv(matrix)
            mean[run, node] = cov[run, node] @ vector
    return Gaussian(mean, cov)


def timed(run: Callable[[], object], nodes: int) -> Callable[[], float]:
    """Seconds of the processor per node, of several goes."""

    def once() -> float:
        started = time.thread_time()
        for _ in range(REPEATS):
            run()
        return (time.thread_time() - started) / (REPEATS * nodes)

    return once


def main() -> Figures:
    """Print and return what a node costs, and ratios."""
    setup, single = network(1, by_sharpness=False)
    fleets = {
        "1 round": (single, 1),
        f"{MANY} rounds": (network(MANY, by_sharpness=False)[1], MANY),
        "1 round by sharpness": (network(1, by_sharpness=True)[1], 1),
        f"{MANY} rounds by sharpness": (network(MANY, by_sharpness=True)[1], MANY),
    }
    given = beliefs(len(setup.prior_mean))
    few = Gaussian(*(np.ascontiguousarray(part[:LOOP_RUNS]) for part in given))
    once = Gaussian(*(part[:LOOP_RUNS] for part in fuse(single, given, 1)))
    twice = Gaussian(*(part[:LOOP_RUNS] for part in fuse(fleets[f"{MANY} rounds"][0], given, MANY)))
    _check(once, loop(few, setup))
    many = few
    for _ in range(MANY):
        many = loop(many, setup)
    _check(twice, many)

    contestants = {"loop": timed(lambda: loop(few, setup), NODES * LOOP_RUNS)}
    for name, (fleet, rounds) in fleets.items():
        run = timed(lambda fleet=fleet, rounds=rounds: fuse(fleet, given, rounds), NODES * RUNS)
        contestants[f"numpy, {name}"] = without_kernels(run)
        if compiled.KERNELS is not None:
            contestants[f"compiled, {name}"] = run
    return _figures(in_turns(contestants, TURNS))


def _check(found: Gaussian, expected: Gaussian) -> None:
    for array, right in zip(found, expected, strict=True):
        np.testing.assert_allclose(array, right, rtol=1e-9, atol=1e-11)


def _figures(given: dict[str, list[float]]) -> Figures:
    say(f"fusion, covariance intersection, {NODES} nodes x {RUNS} runs, n = 4, {TURNS} turns")
    results: Figures = {}
    for name, spent in given.items():
        beside = ratio(given["loop"], spent)
        say(
            f"  {name:<32}{median_us(spent):>9.3f} us per node{beside.value:>9.1f} x the loop "
            f"({beside.low:.1f} - {beside.high:.1f})"
        )
        results[f"{name} us"] = figure([1e6 * one for one in spent], "us/node", "less")
        results[f"{name} x loop"] = beside
    for kind in ("numpy", "compiled"):
        for how in ("", " by sharpness"):
            one, many = f"{kind}, 1 round{how}", f"{kind}, {MANY} rounds{how}"
            if one not in given:
                continue
            pairs = zip(given[many], given[one], strict=True)
            cost = figure([after / before for after, before in pairs], "x", "less")
            results[f"{kind}, five rounds over one{how}"] = cost
            say(
                f"  {kind}{how}: {MANY} rounds cost {cost.value:.2f} x one "
                f"({cost.low:.2f} - {cost.high:.2f})"
            )
    return results


if __name__ == "__main__":
    main()
