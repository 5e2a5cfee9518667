"""The age of information in a recommended network: its bound, and what fresh runs show."""

from typing import NamedTuple

import numpy as np

from concord.bus.information_age import greatest_ages_steps, worst_age_steps
from concord.experiments.design.search import FRESH_RUN
from concord.experiments.monte_carlo.run_figures import kept
from concord.experiments.monte_carlo.simulate import simulate
from concord.experiments.results.record_spread import RecordSpread, record_ages
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario, lossy_links

_RUNS = 5


class InformationAge(NamedTuple):
    """How far, in steps, what a node knows of another is behind what that one has read, at most.

    `bound_steps` follows from schedule and graph; None where they bound it not.
    `observed_steps` is the greatest of a few runs.
    """

    bound_steps: int | None
    observed_steps: int


def information_age(scenario: Scenario) -> InformationAge | None:
    """Return the age of a network; None where runs do not show it: the network changes, or links
    lose the frames of a rule that averages."""
    if scenario.changes:
        return None
    setup, loses = prepare(scenario), lossy_links(scenario)
    schedule = build_bus(setup).schedule
    bound = None if loses else worst_age_steps(schedule, setup.neighbours, scenario.rounds)
    histories = simulate(setup, range(FRESH_RUN, FRESH_RUN + _RUNS))
    if histories.spreads:
        return InformationAge(bound, max(map(_record_lag, histories.spreads)))
    if loses:
        return None
    readings, _ = kept(histories)
    observed = 0
    for sent, read in zip(histories.payload_bytes > 0, ~np.isnan(readings), strict=True):
        cycles, taken = sent.reshape(-1, schedule.nodes), read.any(axis=(-1, -2))
        ages = greatest_ages_steps(
            schedule, setup.neighbours, scenario.rounds, len(taken), cycles.__getitem__,
            taken.__getitem__,
        )  # fmt: skip
        observed = max(observed, int(ages.max()))
    return InformationAge(bound, observed)


def _record_lag(spread: RecordSpread) -> int:
    """How many steps the newest record of a source at any node is behind that at its source."""
    ages = record_ages(spread)
    own = ages.diagonal(axis1=0, axis2=2)
    steps, first = np.arange(len(own))[:, None], spread.taken.argmax(axis=0)
    behind = np.where(ages < 0, steps + 1 - first, ages) - own
    return int(behind[:, own >= 0].max(initial=0))
