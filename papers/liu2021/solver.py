"""The same ellipsoids by a semidefinite solver: a cross-check, and the cost of a cycle by method.

Needs the optional extra `convex` (cvxpy and clarabel), and only when called. Slow, and accurate to
what its solver reaches; no filter depends on it.

Source: Liu et al. (2021), theorem 1 and corollary 1 as printed, with the signs of (20).
"""

import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.bus_readings import augmented
from concord.features.sets.filters.cycle import turned
from concord.features.sets.filters.ellipsoid import Ellipsoid, shape_matrix
from concord.features.sets.filters.multipliers import Problem
from concord.features.sets.filters.recursive_estimator import problem
from concord.papers.liu2021.runs import ESTIMATORS, HELD, PLANT, G, N, SequenceBatch, printed_step


class Solution(NamedTuple):
    """Result of the solver: P (n, n), L (n, m), multipliers (c,), and its own verdict."""

    shape: np.ndarray
    gain: np.ndarray
    multipliers: np.ndarray
    status: str


class SolverFailed(RuntimeError):
    """The solver gave up; the message is its own."""


def matrix_inequality(like: Problem) -> Callable[[Problem], Solution]:
    """A solver of min tr P subject to [[M(tau), Gamma'], [Gamma, P]] >= 0 and tau >= 0.

    P, L in Gamma = image - L known, and tau are all unknowns, as in the paper. For problems of one
    lane with the sizes of `like`: the programme is compiled once, with their numbers as parameters.

    Raises:
        ImportError: cvxpy is not installed.
        SolverFailed: by the function that is returned: no solution, not even an inaccurate one.
    """
    import cvxpy

    count, size = like.terms.shape[-3:-1]
    terms = [cvxpy.Parameter((size, size), symmetric=True) for _ in range(count)]
    image, known = cvxpy.Parameter(like.image.shape), cvxpy.Parameter(like.known.shape)
    shape = cvxpy.Variable((len(like.image), len(like.image)), symmetric=True)
    gain = cvxpy.Variable((len(like.image), len(like.known)))
    multipliers = cvxpy.Variable(count, nonneg=True)
    certificate = np.diag(np.eye(size)[0])
    for i, term in enumerate(terms):
        certificate = certificate + multipliers[i] * term
    residual = image - gain @ known
    inequality = cvxpy.bmat([[certificate, residual.T], [residual, shape]])
    # Symmetric by construction, but the modelling layer cannot see it.
    programme = cvxpy.Problem(
        cvxpy.Minimize(cvxpy.trace(shape)), [0.5 * (inequality + inequality.T) >> 0]
    )

    def solve(problem: Problem) -> Solution:
        for parameter, term in zip(terms, problem.terms, strict=True):
            parameter.value = 0.5 * (term + term.T)
        image.value, known.value = problem.image, problem.known
        try:
            programme.solve(solver=cvxpy.CLARABEL)
        except cvxpy.SolverError as error:
            raise SolverFailed(str(error)) from None
        if shape.value is None or gain.value is None or multipliers.value is None:
            raise SolverFailed(f"the solver ended with {programme.status!r} and no solution")
        return Solution(shape.value, gain.value, multipliers.value, str(programme.status))

    return solve


# --- cost ----------------------------------------------------------------------------------------

_REPETITIONS = 3


class Costs(NamedTuple):
    """Rows of (method, ms a cycle, how far tr P is from the exact one's, None if not compared).

    solver: the largest relative difference of traces to those of the semidefinite solver on the
        reduced programme; None where no solver is installed.
    """

    rows: list[tuple[str, float, float | None]]
    solver: float | None


def measure(batch: SequenceBatch) -> Costs:
    """Of a batch with one sequence."""
    rows: list[tuple[str, float, float | None]] = []
    for name, estimate in ESTIMATORS.items():
        spent = []
        for _ in range(_REPETITIONS):
            started = time.perf_counter()
            estimate(batch)
            spent.append(time.perf_counter() - started)
        rows.append((name, 1e3 * min(spent) / batch.cycles, None))
    try:
        solved = [_by_solver(batch, reduce=True), _by_solver(batch, reduce=False)]
    except ImportError:
        return Costs(rows, None)
    names = ("semidefinite solver, reduced", "semidefinite solver, (20) as printed")
    for name, (spent_ms, apart) in zip(names, solved, strict=True):
        rows.append((name, spent_ms, apart))
    return Costs(rows, solved[0][1])


def _by_solver(batch: SequenceBatch, reduce: bool) -> tuple[float, float]:
    """Milliseconds a cycle but the first, which compiles, and the largest difference of traces."""
    size = G * N + HELD
    kept = Ellipsoid(np.zeros((1, size)), np.broadcast_to(np.eye(size), (1, size, size)))
    solve: Callable[[Problem], Solution] | None = None
    spent, apart = [], []
    for cycle in range(batch.cycles):
        model = augmented(PLANT, batch.received, cycle)
        position = turned(kept.factor, model) if reduce else kept.factor
        lane = problem(kept, model, position)
        lane = Problem(lane.terms[0], lane.balls, lane.image[0], lane.known[0])
        kept = printed_step(kept, model, batch.received.values[:, cycle]).after
        solve = solve or matrix_inequality(lane)
        started = time.perf_counter()
        # It says of some that they may be inaccurate; how much is what is measured here.
        with warnings.catch_warnings(), suppress(SolverFailed):
            warnings.simplefilter("ignore")
            ours = np.trace(shape_matrix(kept)[0])
            apart.append(abs(np.trace(solve(lane).shape) / ours - 1.0))
        spent.append(time.perf_counter() - started)
    return 1e3 * float(np.mean(spent[1:])), float(max(apart, default=np.nan))
