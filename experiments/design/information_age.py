"""The age of information in a recommended network: its bound, and what fresh runs show."""

from typing import NamedTuple

import numpy as np

from concord.bus.information_age import greatest_ages_steps, worst_age_steps
from concord.experiments.design.search import FRESH_RUN
from concord.experiments.monte_carlo.run_figures import kept
from concord.experiments.monte_carlo.simulate import simulate
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario, lossy_links

_RUNS = 5


class InformationAge(NamedTuple):
    """How far, in steps, what a node knows of another is behind what that one has read, at most.

    `bound_steps` follows from schedule and graph;
    `observed_steps` is the greatest of a few runs.
    """

    bound_steps: int
    observed_steps: int


def information_age(scenario: Scenario) -> InformationAge | None:
    """Return the age of a network; None where nothing bounds it: nodes contend for slots, links
    lose frames, or the network changes."""
    if lossy_links(scenario) or scenario.changes:
        return None
    setup = prepare(scenario)
    schedule = build_bus(setup).schedule
    bound = worst_age_steps(schedule, setup.neighbours, scenario.rounds)
    if bound is None:
        return None
    histories = simulate(setup, range(FRESH_RUN, FRESH_RUN + _RUNS))
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
