"""Warnings of figures that rest on few samples: few scored steps of a run, or few runs."""

from collections.abc import Iterator

from concord.results.figures.summary import LEAST_RUNS
from concord.scenarios.catalogue import as_long_as, definition_of
from concord.scenarios.scenario import Scenario

LEAST_STEPS = 20


def few_steps(scenario: Scenario) -> Iterator[str]:
    """Yield a sentence if fewer than `LEAST_STEPS` steps of a run are scored."""
    first = min(definition_of(scenario).score.first_step, scenario.steps - 1)
    scored = scenario.steps - first
    if scored < LEAST_STEPS:
        enough = definition_of(scenario).score.first_step + LEAST_STEPS
        yield (
            f"only {scored} step{' is' if scored == 1 else 's are'} scored (from step {first} of "
            f"{scenario.steps}): errors and ANEES are mostly chance; use "
            + as_long_as(scenario, enough)
        )


def few_runs(runs: int) -> Iterator[str]:
    """Yield a sentence if there are fewer than `LEAST_RUNS` runs."""
    if runs < LEAST_RUNS:
        yield (
            f"only {runs} run{'s' if runs > 1 else ''}: the intervals over runs are wide or "
            f"unknown; use --runs {LEAST_RUNS} or more"
        )
