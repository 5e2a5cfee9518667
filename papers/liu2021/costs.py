"""Measure the cost of a cycle of the set-membership example by method, and cross-check it."""

import time
import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.bus_readings import augmented
from concord.features.sets.filters.cycle import turned
from concord.features.sets.filters.ellipsoid import Ellipsoid, shape_matrix
from concord.features.sets.filters.multipliers import Problem
from concord.features.sets.filters.recursive_estimator import problem
from concord.papers.liu2021.runs import ESTIMATORS, HELD, PLANT, G, N, SequenceBatch, printed_step
from concord.papers.liu2021.semidefinite import Solution, SolverFailed, matrix_inequality

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
        solution = _solution(solve, lane)
        spent.append(time.perf_counter() - started)
        if solution is not None:
            ours = np.trace(shape_matrix(kept)[0])
            apart.append(abs(np.trace(solution.shape) / ours - 1.0))
    return 1e3 * float(np.mean(spent[1:])), float(max(apart, default=np.nan))


def _solution(solve: Callable[[Problem], Solution], lane: Problem) -> Solution | None:
    with warnings.catch_warnings():
        # It says of some that they may be inaccurate; how much is what is measured here.
        warnings.simplefilter("ignore")
        try:
            return solve(lane)
        except SolverFailed:
            return None
