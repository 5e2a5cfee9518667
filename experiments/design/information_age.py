"""The age of information in a recommended network: its bound, and what fresh runs show."""

from typing import NamedTuple

import numpy as np

from concord.bus.contended_bus import ContendedBus
from concord.bus.information_age import (
    first_newer,
    greatest_ages_steps,
    lags_steps,
    worst_age_steps,
    worst_contended_age_steps,
)
from concord.experiments.design.search import FRESH_RUN
from concord.experiments.monte_carlo.run_figures import kept
from concord.experiments.monte_carlo.simulate import simulate
from concord.experiments.results.record_spread import RecordSpread, record_ages
from concord.scenarios.build import build_bus
from concord.scenarios.labelled import window_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario, lossy_links
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import arbiter_of, trigger_of
from concord.scenarios.types.rules import FloodingRule

_RUNS = 5
_APART = "a node never hears of another"


class InformationAge(NamedTuple):
    """For how many steps a node has lacked readings that another has taken, at most.

    `bound_steps` follows from schedule, graph and arbiter, and `why` says from what more; None
    where there is no bound, and then `why` is the reason. `observed_steps` is the greatest of a few
    runs.
    """

    bound_steps: int | None
    observed_steps: int
    why: str = ""


def information_age(scenario: Scenario) -> InformationAge | None:
    """Return the age of a network; None where runs do not show it: the network changes, or links
    lose the frames of a rule that averages."""
    if scenario.changes:
        return None
    setup, loses = prepare(scenario), lossy_links(scenario)
    schedule = build_bus(setup).schedule
    bound, why = _bound(setup)
    histories = simulate(setup, range(FRESH_RUN, FRESH_RUN + _RUNS))
    if histories.spreads:
        return InformationAge(bound, max(map(_record_lag, histories.spreads)), why)
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
    return InformationAge(bound, observed, why)


def _bound(setup: Setup) -> tuple[int | None, str]:
    """Return the bound of a network, and what it follows from beside schedule and graph, or why
    there is none."""
    scenario, bus = setup.scenario, build_bus(setup)
    schedule, contention = bus.schedule, scenario.bus.schedule
    if lossy_links(scenario):
        return None, "links lose frames"
    if not any(schedule.contenders(cycle) for cycle in range(schedule.period)):
        worst = worst_age_steps(schedule, setup.neighbours, scenario.rounds)
        return worst, "" if worst is not None else _APART
    if trigger_of(contention) > 0:
        return None, "a node with little news (--trigger) is silent, however old its last share is"
    wait = bus.longest_wait if isinstance(bus, ContendedBus) else None
    if wait is None:
        return None, f"a node may lose every contest with --arbiter {arbiter_of(contention)}"
    floods = isinstance(scenario.rule, FloodingRule)
    if floods:
        # A node without news does not ask.
        wait = wait._replace(next_cycles=wait.first_cycles)
    worst = worst_contended_age_steps(schedule, setup.neighbours, scenario.rounds, wait)
    if worst is None:
        return None, _APART
    why = f"a contender wins once in {wait.next_cycles} cycles at least"
    window = window_of(scenario, setup.neighbours) if floods else worst + 1
    if worst >= window:
        late = f"a record may then be {worst} steps old, and a window holds {window} steps"
        return None, f"{why}; {late}"
    return worst, why


def _record_lag(spread: RecordSpread) -> int:
    """For how many steps a node has lacked records that their source held."""
    ages = record_ages(spread).swapaxes(0, 1)
    newest = np.where(ages < 0, -1, np.arange(len(ages))[:, None, None] - ages)
    first = first_newer(newest.diagonal(axis1=1, axis2=2))
    return max(int(lags_steps(one, first, step).max()) for step, one in enumerate(newest))
