"""Warnings of figures that rest on few samples: scored steps of a run, few runs, or one of many."""

from collections.abc import Iterator

import numpy as np

from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario

LEAST_STEPS, LEAST_RUNS = 20, 5


def few_steps(scenario: Scenario) -> Iterator[str]:
    """Yield a sentence if fewer than `LEAST_STEPS` steps of a run are scored."""
    first = min(definition_of(scenario).score.first_step, scenario.steps - 1)
    scored = scenario.steps - first
    if scored < LEAST_STEPS:
        enough = definition_of(scenario).score.first_step + LEAST_STEPS
        yield (
            f"only {scored} step{' is' if scored == 1 else 's are'} scored (from step {first} of "
            f"{scenario.steps}): errors and ANEES are mostly chance; use --steps {enough} or more"
        )


def few_runs(runs: int) -> Iterator[str]:
    """Yield a sentence if there are fewer than `LEAST_RUNS` runs."""
    if runs < LEAST_RUNS:
        yield (
            f"only {runs} run{'s' if runs > 1 else ''}: the intervals over runs are wide or "
            f"unknown; use --runs {LEAST_RUNS} or more"
        )


def decisive_run(errors: np.ndarray, first_run: int = 0) -> str | None:
    """Return a sentence if one of the runs outweighs all others in their squared errors (R,).

    In such a run the target may have left all sensors, or a filter has lost it.
    """
    squares = np.nan_to_num(np.square(errors))
    if len(squares) < LEAST_RUNS or 2 * squares.max() <= squares.sum():
        return None
    run = first_run + int(squares.argmax())
    return (
        f"run {run} has more than half of the squared error of all {len(squares)} runs, so ratios "
        f"and intervals are mostly those of run {run}; look at it with --run {run}"
    )
