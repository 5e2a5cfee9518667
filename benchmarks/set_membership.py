"""The set-membership example: exact elimination and the closed form beside a semidefinite solver.

The generic route is the paper's: (20) as printed, P, L and all multipliers unknown, through a
modelling layer (cvxpy with Clarabel, compiled once, numbers as parameters). All take the same 13
cycles from the same ellipsoids, in turns, so that the machine is as busy for one as for the others.
All figures are processor time.

The case: seed 1, the paper's own noise, 4 states, 4 outputs of which 2 contend, 3 steps a cycle;
the first cycle is left out. Its aims are 30 times the generic solver for the exact elimination and
400 times for the closed form.

A second case is a cycle of `tight` with 50 states: 8 outputs of which 4 contend, 2 noises, 5 steps
a cycle, a stable plant drawn with seed 1. Its aim is 0.2 s.
"""

import statistics
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.measure import BenchmarkFigures, figure, ratio
from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.delivered import bus_of_outputs, delivered
from concord.features.sets.filters.bus_readings import MeasuredPlant, augmented, cycle_evidence
from concord.features.sets.filters.cycle import CycleResult, turned
from concord.features.sets.filters.ellipsoid import Ellipsoid, image, shape_matrix
from concord.features.sets.filters.lifted_cycle import AugmentedCycle, DeliveredValues
from concord.features.sets.filters.multipliers import Problem
from concord.features.sets.filters.recursive_estimator import problem
from concord.features.sets.filters.tight_estimator import conditioned_step
from concord.papers.liu2021.runs import (
    HELD,
    PLANT,
    G,
    N,
    printed_fast_step,
    printed_step,
    simulate,
)
from concord.papers.liu2021.solver import Solution, SolverFailed, matrix_inequality

CYCLES, REPETITIONS, FAST_CALLS = 13, 5, 20
# States, outputs, those of them that are sent in turn, noises.
MANY_STATES = (50, 8, 4, 2)
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
    } | {
        "exact ms": figure([result["exact_ms"]], "ms", "less"),
        "tight 50 states ms": figure(_many_states(), "ms", "less"),
    }


def _many_states() -> list[float]:
    """Processor time in ms of each cycle of `tight` on a plant with many states."""
    rng = np.random.default_rng(1)
    n, outputs, static, noises = MANY_STATES
    transition = 0.95 * np.linalg.qr(rng.standard_normal((n, n)))[0]
    noise_input = 0.1 * rng.standard_normal((n, noises))
    output = rng.standard_normal((outputs, n)) / np.sqrt(n)
    feedthrough = 0.1 * rng.standard_normal((outputs, noises))
    system = BoundedSystem(
        lambda _: transition,
        lambda _: noise_input,
        lambda _: output,
        lambda _: feedthrough,
        lambda _: np.eye(noises),
    )
    plant = MeasuredPlant(system, static, lambda _: np.ones(outputs - static))
    noise = rng.standard_normal((CYCLES * plant.length, noises))
    noise /= np.linalg.norm(noise, axis=-1, keepdims=True)
    start = rng.standard_normal(n)
    _, read = system.simulate(start / np.linalg.norm(start), noise)
    received = delivered(bus_of_outputs(outputs, static, plant.weights), static, read)
    kept, last = Ellipsoid(np.zeros(n), np.eye(n)), np.eye(plant.length * n)[-n:]
    spent = []
    for cycle in range(CYCLES):
        evidence = cycle_evidence(plant, received, cycle)
        started = time.process_time()
        kept = image(conditioned_step(kept, evidence), last)
        spent.append(1e3 * (time.process_time() - started))
    middle = statistics.median(spent)
    sys.stdout.write(f"set membership, one cycle of `tight` with {n} states: {middle:.0f} ms\n")
    return spent


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
