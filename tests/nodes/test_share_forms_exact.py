"""Consistency of rules whose shares take two bytes a number, without Monte Carlo.

Every error of a linear network is a linear map of independent noises of unit variance. The test
carries these maps, so all joint covariances are exact. The rounding of means counts as noise of
its largest size, common to all receivers of a share. It is written from the formulas of the rules
and knows of the code under test only the forms.
"""

from collections.abc import Iterator

import numpy as np
import pytest

from concord.filters.fusion.packed import pack, unpack
from concord.filters.gaussian import Gaussian, Information
from concord.nodes.share_forms import TwoByteBelief, TwoByteHybrid
from concord.nodes.vector_codec import belief_numbers, belief_of

STATES, NODES, ROUNDS, STEPS = 4, 5, 3, 12
STEP_S = 0.5
F = np.kron(np.eye(2), [[1.0, STEP_S], [0.0, 1.0]])
NOISE = np.kron(np.eye(2), [[STEP_S**2 / 2], [STEP_S]]) * 0.3
SEEN = [np.eye(4)[[0]], np.eye(4)[[2]], None, np.array([[1.0, 0, 1.0, 0]]), None]
PRIOR = np.diag([100.0, 4.0, 100.0, 4.0])
# A ring with weights of a third each.
WEIGHTS = (np.eye(NODES) + np.roll(np.eye(NODES), 1, 0) + np.roll(np.eye(NODES), -1, 0)) / 3


class Noises:
    """Maps of noises (n, k): a new one has columns that no other has."""

    def __init__(self) -> None:
        self.count = 0

    def new(self, factor: np.ndarray) -> np.ndarray:
        found = np.concatenate((np.zeros((len(factor), self.count)), factor), axis=1)
        self.count += factor.shape[1]
        return found

    def wide(self, found: np.ndarray) -> np.ndarray:
        return np.pad(found, ((0, 0), (0, self.count - found.shape[1])))

    def total(self, *maps: np.ndarray) -> np.ndarray:
        return np.sum([self.wide(one) for one in maps], axis=0)


def information_of(node: int) -> tuple[np.ndarray, np.ndarray]:
    """H' R^-1 H and H' R^-1/2 of a node with deviation 1."""
    rows = SEEN[node]
    rows = np.zeros((1, STATES)) if rows is None else rows
    return rows.T @ rows, rows.T


def rounding(cov: np.ndarray) -> np.ndarray:
    """A factor of n diag(step^2 / 4) for steps of a 32nd of the deviation."""
    return np.diag(np.sqrt(STATES * np.diagonal(cov)) / 64)


def ci_shared(noises: Noises, error: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    form = TwoByteBelief(STATES)
    sent = belief_of(form.numbers(form.codes(belief_numbers(Gaussian(np.zeros(STATES), cov)))), 4)
    return noises.total(error, noises.new(rounding(sent.cov))), sent.cov


def ci_steps() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Error maps and covariances of the nodes after each step's rounds."""
    noises = Noises()
    start = noises.new(np.linalg.cholesky(PRIOR))
    beliefs = [(start, PRIOR)] * NODES
    for _ in range(STEPS):
        read = []
        for node, (error, cov) in enumerate(beliefs):
            added, factor = information_of(node)
            after = np.linalg.inv(np.linalg.inv(cov) + added)
            maps = noises.total(np.linalg.solve(cov, error), noises.new(factor))
            read.append((after @ maps, after))
        beliefs = read
        for _ in range(ROUNDS):
            shared = [ci_shared(noises, *one) for one in beliefs]
            fused = []
            for node in range(NODES):
                parts = [
                    (WEIGHTS[node, j], *(beliefs[j] if j == node else shared[j]))
                    for j in range(NODES)
                    if WEIGHTS[node, j]
                ]
                matrix = sum(weight * np.linalg.inv(cov) for weight, _, cov in parts)
                vector = noises.total(*(w * np.linalg.solve(cov, e) for w, e, cov in parts))
                after = np.linalg.inv(matrix)
                fused.append((after @ vector, after))
            beliefs = fused
        for error, cov in beliefs:
            yield noises.wide(error), cov
        common = noises.new(NOISE)
        beliefs = [(noises.total(F @ e, common), F @ P @ F.T + NOISE @ NOISE.T) for e, P in beliefs]


def hybrid_shared(noises: Noises, known: list[np.ndarray]) -> list[np.ndarray]:
    """Prior information, its error, novelty, its error, row; each error is y - Omega x."""
    form = TwoByteHybrid(STATES, NODES)
    matrix, error, added, noise, row = known
    zero = np.zeros(STATES)
    numbers = np.concatenate((pack(Information(zero, matrix)), pack(Information(zero, added)), row))
    back = form.numbers(form.codes(numbers))
    length = len(pack(Information(zero, matrix)))
    kept = unpack(back[:length]).matrix
    novelty = unpack(back[length : 2 * length]).matrix
    cov = np.linalg.inv(kept)
    mean_error = noises.total(np.linalg.solve(matrix, error), noises.new(rounding(cov)))
    pulled = np.linalg.inv(np.linalg.cholesky(cov)).T * np.sqrt(STATES) * form._vector_step / 2
    # Nothing was sent as noisier than it is: the scale covers the novelty.
    assert np.trace(novelty) > 0.9 * np.trace(added) or np.trace(added) < 1e-3 * np.trace(kept)
    told = noises.total(noise, (novelty - added) @ mean_error, noises.new(pulled))
    return [kept, kept @ mean_error, novelty, told, back[2 * length :]]


def hybrid_steps() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    noises = Noises()
    start = noises.new(np.linalg.cholesky(PRIOR))
    beliefs = [(start, PRIOR)] * NODES
    for _ in range(STEPS):
        known = []
        for node, (error, cov) in enumerate(beliefs):
            added, factor = information_of(node)
            prior = np.linalg.inv(cov)
            known.append([prior, prior @ error, added, noises.new(factor), np.eye(NODES)[node]])
        for _ in range(ROUNDS):
            shared = [hybrid_shared(noises, one) for one in known]
            fused = []
            for node in range(NODES):
                heard = [j for j in range(NODES) if WEIGHTS[node, j]]
                parts = [known[j] if j == node else shared[j] for j in heard]
                weights = [WEIGHTS[node, j] for j in heard]
                fused.append(
                    [
                        noises.total(*(w * part[k] for w, part in zip(weights, parts, strict=True)))
                        if k in (1, 3)
                        else sum(w * part[k] for w, part in zip(weights, parts, strict=True))
                        for k in range(5)
                    ]
                )
            known = fused
        beliefs = []
        for prior, error, added, noise, row in known:
            gain = 1 / row.max()
            after = np.linalg.inv(prior + gain * added)
            beliefs.append((after @ noises.total(error, gain * noise), after))
        for error, cov in beliefs:
            yield noises.wide(error), cov
        common = noises.new(NOISE)
        beliefs = [(noises.total(F @ e, common), F @ P @ F.T + NOISE @ NOISE.T) for e, P in beliefs]


@pytest.mark.parametrize("steps", [ci_steps, hybrid_steps], ids=["ci", "hcmci"])
def test_two_bytes_a_number_stay_consistent(steps):
    """E e e' <= P at every node after every step, rounding at its largest included."""
    worst = 0.0
    for error, cov in steps():
        whitener = np.linalg.inv(np.linalg.cholesky(cov))
        true = whitener @ error @ error.T @ whitener.T
        worst = max(worst, float(np.linalg.eigvalsh(true)[-1]))
    # The rules themselves are consistent, and tight from the common beginning on.
    assert 0.5 < worst <= 1 + 1e-9
