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

import numpy as np

from experiments.reproduce_liu2021_runs import G, HELD, N, PLANT, simulate
from filters.ellipsoid import Ellipsoid, shape_matrix
from filters.set_membership_cycle import turned
from filters.set_membership_fast import closed_form_step
from filters.set_membership_paper import optimal_step, problem
from filters.set_membership_sdp import SolverFailed, matrix_inequality
from scenarios.liu2021_bus import augmented

CYCLES, REPETITIONS, FAST_CALLS = 13, 5, 20


def main() -> dict[str, float]:
    """Print and return milliseconds per cycle and how many times as fast as the generic route."""
    batch = simulate(seed=1, sequences=0, cycles=CYCLES)
    times: dict[str, list[list[float]]] = {"generic": [], "reduced": [], "exact": [], "fast": []}
    solvers: dict[str, Callable] = {}
    failed, worst = 0, 0.0
    size = G * N + HELD
    kept = Ellipsoid(np.zeros(size), np.eye(size))
    for cycle in range(CYCLES):
        model = augmented(PLANT, batch.received, cycle)
        model = model._replace(**{name: getattr(model, name)[0] for name in _PER_LANE})
        received = batch.received.values[0, cycle]
        step = optimal_step(kept, model, received)
        trace = np.trace(shape_matrix(step.after))
        programmes = {
            "generic": problem(kept, model, kept.factor),
            "reduced": problem(kept, model, turned(kept.factor, model)),
        }
        for name, programme in programmes.items():
            solvers.setdefault(name, matrix_inequality(programme))
        row: dict[str, list[float]] = {name: [] for name in times}
        for _ in range(REPETITIONS):
            for name, programme in programmes.items():
                spent, solution = _timed(lambda n=name, p=programme: _solve(solvers[n], p))
                row[name].append(spent)
                if solution is None:
                    failed += 1
                else:
                    worst = max(worst, abs(np.trace(solution) / trace - 1.0))
            row["exact"].append(_timed(lambda: optimal_step(kept, model, received))[0])
            row["fast"].append(_timed(lambda: _many(closed_form_step, kept, model, received))[0])
        for name, spent in row.items():
            times[name].append(spent)
        kept = step.after
    return _report(times, failed, worst)


_PER_LANE = ("transition", "noise", "output", "output_noise", "winner")


def _solve(solver: Callable, programme: object) -> np.ndarray | None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return solver(programme).shape
        except SolverFailed:
            return None


def _many(step: Callable, kept: Ellipsoid, model: object, received: np.ndarray) -> None:
    for _ in range(FAST_CALLS):
        step(kept, model, received)


def _timed(work: Callable) -> tuple[float, np.ndarray | None]:
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def _report(times: dict[str, list[list[float]]], failed: int, worst: float) -> dict[str, float]:
    # The first cycle compiles the programmes, which is not held against them.
    each = {
        name: 1e3 * statistics.mean(statistics.median(spent) for spent in cycles[1:])
        for name, cycles in times.items()
    }
    each["fast"] /= FAST_CALLS
    result = {
        **{f"{name}_ms": value for name, value in each.items()},
        "exact_ratio": each["generic"] / each["exact"],
        "fast_ratio": each["generic"] / each["fast"],
        "exact_ratio_reduced": each["reduced"] / each["exact"],
        "fast_ratio_reduced": each["reduced"] / each["fast"],
        "failed": failed,
        "largest_trace_difference": worst,
    }
    sys.stdout.write(
        f"set membership, one cycle of the example: semidefinite as printed {each['generic']:.0f} "
        f"ms, reduced {each['reduced']:.0f} ms ({failed} failed, traces within {worst:.1g}); exact "
        f"elimination {each['exact']:.2f} ms, {result['exact_ratio']:.0f} times as fast as printed "
        f"({result['exact_ratio_reduced']:.0f} as reduced); closed form {each['fast']:.3f} ms, "
        f"{result['fast_ratio']:.0f} times ({result['fast_ratio_reduced']:.0f})\n"
    )
    return result


if __name__ == "__main__":
    main()
