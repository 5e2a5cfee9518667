"""The age of information in a recommended network: its bound, and what fresh runs show."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.bus.information_age import first_newer, greatest_ages_steps, lags_steps
from concord.results.records.record_spread import RecordSpread, in_time, record_ages
from concord.results.records.runs import Runs
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.labelled import window_of
from concord.scenarios.scenario import Scenario, lossy_links
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import withdraws
from concord.scenarios.types.rules import FloodingRule
from concord.studies.design.age_bound import age_bound
from concord.studies.design.search import FRESH_RUN
from concord.studies.monte_carlo.simulate import simulate

_RUNS = 5


class InformationAge(NamedTuple):
    """For how many steps a node has lacked readings that another has taken, at most.

    `bound_steps` follows from schedule, graph and arbiter, and `why` says from what more; None
    where there is no bound, and then `why` is the reason. `observed_steps` is the greatest of a few
    runs. Where a rule floods records, a record that outlives its window on the way is lost, and
    neither figure counts it. `lost` is the part of (record, other node) pairs in which that
    happened; None where it is not known.
    """

    bound_steps: int | None
    observed_steps: int
    why: str = ""
    lost: float | None = None


def information_age(scenario: Scenario) -> InformationAge | None:
    """Return the age of a network; None where runs do not show it: the network changes, or links
    lose the frames of a rule that averages, or its shares may be cut."""
    if scenario.changes:
        return None
    setup = prepare(scenario)
    bound, why = age_bound(setup)
    runs = simulate(setup, range(FRESH_RUN, FRESH_RUN + _RUNS))
    spreads, lost = runs.spreads, None
    if spreads:
        observed = max(map(record_lag_steps, spreads))
        arrived = np.concatenate([in_time(one) for one in spreads])
        lost = 1 - float(arrived.mean()) if arrived.size else None
    elif lossy_links(scenario) or not withdraws(scenario.bus):
        return None
    else:
        observed = _share_lag_steps(setup, runs)
    if isinstance(scenario.rule, FloodingRule):
        # A lag grows by one a step, so the greatest one passes the window's last step on its way.
        window = window_of(scenario, setup.neighbours)
        observed = min(observed, window - 1)
        if bound is None or bound >= window:
            alone = f"any age: {why}" if bound is None else f"{bound} steps"
            why = f"a record that leaves its window of {window} steps is lost"
            bound, why = window - 1, f"{why} (schedule and graph allow {alone})"
    return InformationAge(bound, observed, why, lost)


def worst_age(scenarios: Sequence[Scenario]) -> InformationAge | None:
    """Return the age of a network that must bear all of these, such as placements of its sensors;
    None where that of one is not known."""
    ages = [information_age(one) for one in scenarios]
    known = [one for one in ages if one is not None]
    if len(known) < len(ages):
        return None
    worst = max(known, key=lambda one: np.inf if one.bound_steps is None else one.bound_steps)
    lost = [one.lost for one in known if one.lost is not None]
    return worst._replace(
        observed_steps=max(one.observed_steps for one in known),
        lost=float(np.mean(lost)) if lost else None,
    )


def _share_lag_steps(setup: Setup, runs: Runs) -> int:
    """Return for how many steps a node has lacked readings whose shares could have reached it."""
    schedule, rounds = build_bus(setup).schedule, setup.scenario.rounds
    assert runs.readings is not None, "keep the readings"
    observed = 0
    for sent, read in zip(runs.payload_bytes > 0, ~np.isnan(runs.readings), strict=True):
        cycles, taken = sent.reshape(-1, schedule.nodes), read.any(axis=(-1, -2))
        ages = greatest_ages_steps(
            schedule, setup.neighbours, rounds, len(taken), cycles.__getitem__, taken.__getitem__
        )
        observed = max(observed, int(ages.max()))
    return observed


def record_lag_steps(spread: RecordSpread) -> int:
    """Return for how many steps a node has lacked records that their source held."""
    ages = record_ages(spread).swapaxes(0, 1)
    newest = np.where(ages < 0, -1, np.arange(len(ages))[:, None, None] - ages)
    first = first_newer(newest.diagonal(axis1=1, axis2=2))
    return max(int(lags_steps(one, first, step).max()) for step, one in enumerate(newest))
