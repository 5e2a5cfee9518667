"""The set-membership example: exact elimination and the closed form beside a semidefinite solver.

The generic route is the paper's: (20) as printed, P, L and all multipliers unknown, through a
modelling layer (cvxpy with Clarabel, compiled once, numbers as parameters). All take the same 13
cycles from the same ellipsoids, in turns, so that the machine is as busy for one as for the others.
"""

import statistics
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.measure import BenchmarkFigures, figure, ratio
from concord.filters.sets.bus_readings import augmented
from concord.filters.sets.cycle import CycleResult, turned
from concord.filters.sets.ellipsoid import Ellipsoid, shape_matrix
from concord.filters.sets.lifted_cycle import AugmentedCycle, DeliveredValues
from concord.filters.sets.multipliers import Problem
from concord.filters.sets.recursive_estimator import problem
from concord.papers.liu2021.runs import (
    HELD,
    PLANT,
    G,
    N,
    printed_fast_step,
    printed_step,
    simulate,
)
from concord.papers.liu2021.semidefinite import Solution, SolverFailed, matrix_inequality

CYCLES, REPETITIONS, FAST_CALLS = 13, 5, 20
METHODS = ("generic", "reduced", "exact", "fast")


def main() -> BenchmarkFigures:
    """Print and return milliseconds per cycle and how many times as fast as the generic route."""
    received = DeliveredValues(
        *(part[0] for part in simulate(seed=1, sequences=0, cycles=CYCLES).received)
    )
    size = G * N + HELD
    kept = Ellipsoid(np.zeros(size), np.eye(size))
    solvers: dict[str, Callable[[Problem], Solution]] = {}
    times: dict[str, list[float]] = {name: [] for name in METHODS}
    apart: list[float] = []
    for cycle in range(CYCLES):
        model = augmented(PLANT, received, cycle)
        values = received.values[cycle]
        after = printed_step(kept, model, values).after
        work = {
            "generic": partial(_solve, solvers, "generic", problem(kept, model, kept.factor)),
            "reduced": partial(
                _solve, solvers, "reduced", problem(kept, model, turned(kept.factor, model))
            ),
            "exact": partial(_step, printed_step, 1, kept, model, values),
            "fast": partial(_step, printed_fast_step, FAST_CALLS, kept, model, values),
        }
        spent: dict[str, list[float]] = {name: [] for name in METHODS}
        for _ in range(REPETITIONS):
            for name, one in work.items():
                started = time.process_time()
                shape = one()
                spent[name].append(time.process_time() - started)
                if name in solvers:
                    ours = np.trace(shape_matrix(after))
                    apart.append(np.nan if shape is None else abs(np.trace(shape) / ours - 1.0))
        for name in METHODS:
            times[name].append(statistics.median(spent[name]))
        kept = after
    result = _report(times, np.array(apart))
    return {
        f"{name} x generic": ratio(
            times["generic"][1:],
            [spent / (FAST_CALLS if name == "fast" else 1) for spent in times[name][1:]],
        )
        for name in METHODS[1:]
    } | {"exact ms": figure([result["exact_ms"]], "ms", "less")}


def _solve(
    solvers: dict[str, Callable[[Problem], Solution]], name: str, programme: Problem
) -> np.ndarray | None:
    if name not in solvers:
        solvers[name] = matrix_inequality(programme)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return solvers[name](programme).shape
        except SolverFailed:
            return None


def _step(
    step: Callable[[Ellipsoid, AugmentedCycle, np.ndarray], CycleResult],
    calls: int,
    kept: Ellipsoid,
    model: AugmentedCycle,
    values: np.ndarray,
) -> None:
    for _ in range(calls):
        step(kept, model, values)


def _report(times: dict[str, list[float]], apart: np.ndarray) -> dict[str, float]:
    # The first cycle is left out: it may be caught compiling.
    each = {name: 1e3 * statistics.mean(spent[1:]) for name, spent in times.items()}
    each["fast"] /= FAST_CALLS
    result = {
        **{f"{name}_ms": value for name, value in each.items()},
        "exact_ratio": each["generic"] / each["exact"],
        "fast_ratio": each["generic"] / each["fast"],
        "exact_ratio_reduced": each["reduced"] / each["exact"],
        "fast_ratio_reduced": each["reduced"] / each["fast"],
        "failed": float(np.isnan(apart).sum()),
        "largest_trace_difference": float(np.nanmax(apart)),
    }
    sys.stdout.write(
        f"set membership, one cycle of the example: semidefinite as printed {each['generic']:.0f} "
        f"ms, reduced {each['reduced']:.0f} ms ({result['failed']:.0f} of {len(apart)} failed, "
        f"traces within {result['largest_trace_difference']:.1g}); exact elimination "
        f"{each['exact']:.2f} ms, {result['exact_ratio']:.0f} times as fast as printed "
        f"({result['exact_ratio_reduced']:.0f} as reduced); closed form {each['fast']:.3f} ms, "
        f"{result['fast_ratio']:.0f} times ({result['fast_ratio_reduced']:.0f})\n"
    )
    return result


if __name__ == "__main__":
    main()
