"""Covariance intersection over a whole network: a round beside a loop over nodes, and many rounds.

The benchmark times the rounds of a scenario's rule, which the batched driver executes between the
readings of a step and its estimates. If the weights do not depend on the covariances, the rule
takes all rounds as one product. Otherwise it computes the inverse volumes after every round.
"""

import time
from collections.abc import Callable

import numpy as np

from benchmarks.measure import FULL_BUS, BenchmarkFigures, figure, in_turns, median_us, ratio, say
from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.network import BatchedRule
from concord.runtime.batched.build import build_network
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup

NODES, RUNS, TURNS, LOOP_RUNS, MANY, REPEATS = 20, 500, 15, 5, 5, 5
SCENARIO = "target-crossing"  # four states, on a geometric graph


def network(rounds: int, by_inverse_volume: bool) -> tuple[Setup, BatchedRule]:
    """Return the network of a scenario, and its rule at all nodes of all runs."""
    options = scenario_of(
        scenario=SCENARIO, nodes=NODES, rounds=rounds, seed=1,
        determinant_weights=by_inverse_volume, **FULL_BUS,
    )  # fmt: skip
    setup = prepare(options)
    return setup, build_network(setup, range(RUNS)).segments[0].settings.rule


def beliefs(states: int) -> Gaussian:
    """Beliefs (runs, nodes, n), as the filters leave them."""
    generator = np.random.default_rng(1)
    root = generator.standard_normal((states, states + 2, RUNS, NODES))
    cov = np.einsum("iklm,jklm->ijlm", root, root)
    mean = generator.standard_normal((states, RUNS, NODES))
    return Gaussian(mean.transpose(1, 2, 0), cov.transpose(2, 3, 0, 1))


def fuse(rule: BatchedRule, given: Gaussian, rounds: int) -> Gaussian:
    """Return the beliefs of all nodes after `rounds` rounds in which every frame arrives."""
    content, everybody = rule.start(given), np.ones(given.mean.shape[:2], dtype=bool)
    for _ in range(rounds):
        content = rule.exchange(content, everybody, None)
    return rule.belief(content)


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


def main() -> BenchmarkFigures:
    """Print and return what a node costs, and ratios."""
    setup, single = network(1, by_inverse_volume=False)
    rules = {
        "1 round": (single, 1),
        f"{MANY} rounds": (network(MANY, by_inverse_volume=False)[1], MANY),
        "1 round by inverse_volume": (network(1, by_inverse_volume=True)[1], 1),
        f"{MANY} rounds by inverse_volume": (network(MANY, by_inverse_volume=True)[1], MANY),
    }
    given = beliefs(len(setup.prior_mean))
    few = Gaussian(*(np.ascontiguousarray(part[:LOOP_RUNS]) for part in given))
    once = Gaussian(*(part[:LOOP_RUNS] for part in fuse(single, given, 1)))
    twice = Gaussian(*(part[:LOOP_RUNS] for part in fuse(rules[f"{MANY} rounds"][0], given, MANY)))
    _check(once, loop(few, setup))
    many = few
    for _ in range(MANY):
        many = loop(many, setup)
    _check(twice, many)

    contestants = {"loop": timed(lambda: loop(few, setup), NODES * LOOP_RUNS)}
    for name, (rule, rounds) in rules.items():
        run = timed(lambda rule=rule, rounds=rounds: fuse(rule, given, rounds), NODES * RUNS)
        contestants[f"numpy, {name}"] = run
    return _figures(in_turns(contestants, TURNS))


def _check(found: Gaussian, expected: Gaussian) -> None:
    for array, right in zip(found, expected, strict=True):
        np.testing.assert_allclose(array, right, rtol=1e-9, atol=1e-11)


def _figures(given: dict[str, list[float]]) -> BenchmarkFigures:
    say(f"fusion, covariance intersection, {NODES} nodes x {RUNS} runs, n = 4, {TURNS} turns")
    results: BenchmarkFigures = {}
    for name, spent in given.items():
        beside = ratio(given["loop"], spent)
        say(
            f"  {name:<32}{median_us(spent):>9.3f} us per node{beside.value:>9.1f} x the loop "
            f"({beside.low:.1f} - {beside.high:.1f})"
        )
        results[f"{name} us"] = figure([1e6 * one for one in spent], "us/node", "less")
        results[f"{name} x loop"] = beside
    for how in ("", " by inverse_volume"):
        one, many = f"numpy, 1 round{how}", f"numpy, {MANY} rounds{how}"
        pairs = zip(given[many], given[one], strict=True)
        cost = figure([after / before for after, before in pairs], "x", "less")
        results[f"numpy, five rounds over one{how}"] = cost
        say(
            f"  numpy{how}: {MANY} rounds cost {cost.value:.2f} x one "
            f"({cost.low:.2f} - {cost.high:.2f})"
        )
    return results


if __name__ == "__main__":
    main()
