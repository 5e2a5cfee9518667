"""Predicted against measured convergence of a graph under its weights and links."""

import math
from collections.abc import Callable

import msgspec
import numpy as np
from numpy.typing import NDArray

from concord.studies.topology.subject import Subject
from concord.topology.adjacency import nodes_of
from concord.topology.convergence import (
    MOST_MOMENT_NODES,
    LinkModel,
    MarkovLinks,
    MeasuredRate,
    averaging,
    cycle_factor,
    links_with,
    mean_square_bound,
    mean_square_factor,
    measured_factor,
    rounds_to_settle,
)
from concord.topology.spectrum import DENSE_NODES, second_eigenvalue_modulus
from concord.topology.weights import masked

# The measurement has a stream of its own: what is predicted knows nothing of it.
_PURPOSE = 0x6D656173
_RUNS = 200
# Where nothing is random, runs differ in their beginning alone.
_CERTAIN_RUNS = 4
# Link states that a measurement may go through; a few seconds.
_BUDGET = 4e8
_MOST_ROUNDS = 20_000
_WHATEVER_IT_TAKES = 10**12


class Convergence(msgspec.Struct, frozen=True):
    """By which factor disagreement falls per round, root mean square where links are random.

    `predicted` is None where no formula is known; `difference_percent` is that of the factors,
    `rate_difference_percent` of their logarithms, which says more of factors near 1. In fewer than
    `rounds_to_settle` rounds, which large networks may need too many of, faster modes are measured
    with the slowest.
    """

    links: str
    method: str
    predicted: float | None
    measured: float
    measured_low: float
    measured_high: float
    rounds: int
    rounds_to_settle: int
    runs: int
    difference_percent: float | None
    rate_difference_percent: float | None


def convergence(subject: Subject, seed: int) -> Convergence:
    """Return the factor of a subject, predicted, and measured on random numbers of its own."""
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_PURPOSE,)))
    method, predicted = predicted_factor(subject)
    one_round, redrawn, runs = _rounds(subject, generator)
    nodes, links = nodes_of(subject.weights), max(subject.weights.nnz, 1)
    cycle = max(len(subject.phases), 1)
    most = int(np.clip(_BUDGET / (links * runs), 60, _MOST_ROUNDS))
    rounds = rounds_to_settle(0.95 if predicted is None else predicted, most)
    # Whole cycles in the half that counts, and in each of its batches.
    rounds = math.ceil(rounds / (40 * cycle)) * 40 * cycle
    found = measured_factor(one_round, nodes, runs, rounds, generator, redrawn)
    return _report(subject.links, method, predicted, found)


def random_links(subject: Subject) -> LinkModel | None:
    """Return the links of a subject in which chance has no memory; None for others."""
    kind, numbers, _ = subject.plan
    if kind == "static":
        return links_with(subject.weights, 1.0)
    if kind == "measured":
        assert subject.network.delivery is not None, "subject_of has looked"
        return links_with(subject.weights, subject.network.delivery)
    if kind == "bernoulli":
        return links_with(subject.weights, 1 - numbers[0], together=True)
    return None


def predicted_factor(subject: Subject) -> tuple[str, float | None]:
    """How the factor per round is predicted, and what it is."""
    if subject.plan.kind == "static":
        return "second eigenvalue modulus of W", second_eigenvalue_modulus(subject.weights)
    if subject.phases:
        if nodes_of(subject.weights) > DENSE_NODES:
            return f"no prediction for more than {DENSE_NODES} nodes", None
        phases = [masked(subject.weights, phase) for phase in subject.phases]
        return f"second eigenvalue modulus of the product over {len(phases)} steps", cycle_factor(
            phases
        )
    links = random_links(subject)
    if links is None:
        return "no formula for links with memory", None
    if links.nodes > MOST_MOMENT_NODES:
        return "upper bound: norm of E[W'PW]", mean_square_bound(links)
    return "spectral radius of E[W (x) W] on disagreements", mean_square_factor(links)


def _rounds(
    subject: Subject, generator: np.random.Generator
) -> tuple[Callable[[np.ndarray, int], np.ndarray], Callable[[NDArray[np.intp]], None], int]:
    """The averaging of a subject, whom to tell of runs that are drawn anew, and how many runs."""
    if subject.phases:
        phases = [masked(subject.weights, phase) for phase in subject.phases]
        return lambda x, k: phases[k % len(phases)] @ x, _forget, _CERTAIN_RUNS
    if subject.plan.kind == "static":
        return lambda x, _: subject.weights @ x, _forget, _CERTAIN_RUNS
    links = random_links(subject)
    if links is not None:
        return averaging(links, generator), _forget, _RUNS
    failure, repair = subject.plan.numbers
    lasting = links_with(subject.weights, 1.0, together=True)
    markov = MarkovLinks(lasting, failure, repair, _RUNS, generator)
    return markov.one_round, markov.redrawn, _RUNS


def _forget(_chosen: NDArray[np.intp]) -> None:
    """Nothing is remembered of a run."""


def _report(links: str, method: str, predicted: float | None, found: MeasuredRate) -> Convergence:
    difference = rates = None
    if predicted is not None:
        difference = 100 * abs(found.factor - predicted) / max(predicted, 1e-12)
        if predicted < 1e-9 and found.factor < 1e-9:
            difference = 0.0
        elif 0 < predicted < 1 and 0 < found.factor < 1:
            rates = 100 * abs(math.log(found.factor) / math.log(predicted) - 1)
    return Convergence(
        links, method, predicted, found.factor, found.low, found.high, found.rounds,
        rounds_to_settle(found.factor if predicted is None else predicted, _WHATEVER_IT_TAKES),
        found.runs, difference, rates,
    )  # fmt: skip
