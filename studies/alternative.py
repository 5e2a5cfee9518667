"""An alternative to the rule of a run: labelled measurements, on the same noise and bus."""

import shlex
from math import isnan
from typing import NamedTuple

from concord.filters.metrics import rmse
from concord.results.bus.bus_times import shares_of, wire_per_step
from concord.results.figures.summary import Summary
from concord.results.records.runs import Runs
from concord.scenarios.build import build_bus
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import in_options
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.rules import MeasurementFlooding
from concord.scenarios.types.schedules import DynamicSchedule, PartialSchedule

# A larger network takes longer than a reader of figures wants to wait: some seconds here.
_MOST_LANE_STEPS = 4_000
_LEAST_SCORED_STEPS = 20
_OCCUPANCY = 0.25


class BetterRule(NamedTuple):
    """A run under rule `labelled` that would have a smaller error: its command, its error beside
    the filter that hears everything, and its bytes a step; None on a bus without time."""

    command: str
    to_centralised: float
    bytes_per_step: float | None

    def in_words(self) -> str:
        """ "1.17 x the filter that hears everything, 381 bytes"."""
        sent = "" if self.bytes_per_step is None else f", {self.bytes_per_step:.0f} bytes"
        return f"{self.to_centralised:.3g} x the filter that hears everything{sent}"


def labelled_beside(runs: Runs, own: Summary) -> BetterRule | None:
    """Return a run of labelled measurements with a smaller error, computed by the batched driver.

    None where it is no better, where the rule cannot run, where it would not meet the same noise (a
    controller acts on estimates, or the network was changed), or where it would take long.
    """
    scenario = runs.setup.scenario
    if definition_of(scenario).wirings or is_set_valued(scenario) or own.verdict.has_failed:
        return None
    changed = scenario.changes or (runs.history is not None and runs.history.changed)
    if isinstance(scenario.rule, MeasurementFlooding) or runs.control is not None or changed:
        return None
    few = runs.steps - own.first_step < _LEAST_SCORED_STEPS or runs.steps < scenario.steps
    if few or scenario.nodes * scenario.steps > _MOST_LANE_STEPS:
        return None
    try:
        found = _simulated(prepare(_labelled(scenario)), own)
    except (ValueError, ArithmeticError):
        # The sentence of a refusal would answer a question that the user has not asked.
        return None
    better = found is not None and found.to_centralised < own.value("to_centralised")
    return found if better else None


def _labelled(scenario: Scenario) -> Scenario:
    """The scenario with the other rule, none of whose options are those of the rule it has.

    Static frames of FlexRay are padded to the longest share, so the rule gets dynamic slots.
    """
    schedule = scenario.bus.schedule
    changed: dict[str, object] = {"rule": "labelled"}
    if isinstance(scenario.bus, FlexRay) and not isinstance(schedule, DynamicSchedule):
        partial = isinstance(schedule, PartialSchedule)
        occupancy = schedule.occupancy if partial else _OCCUPANCY
        changed |= {"schedule": "dynamic", "occupancy": occupancy}
    return scenario.with_(**changed)  # pyright: ignore[reportArgumentType]


def _simulated(setup: Setup, own: Summary) -> BetterRule | None:
    # Only here: most commands that print figures simulate nothing.
    from concord.runtime.batched.build import without_array_form
    from concord.studies.monte_carlo.simulate import simulate

    if without_array_form(setup.scenario) is not None:
        return None
    runs = simulate(setup, [setup.scenario.run])
    states = list(definition_of(setup.scenario).score.states)
    errors = runs.mean[0] - runs.truth[0][:, None]
    found = float(rmse(errors[own.first_step :][..., states], (0, 1)))
    if isnan(found):
        return None
    bus = build_bus(setup)
    sent = wire_per_step(bus, shares_of(runs))[0] if bus.has_time else None
    words = ["concord", "run", "--scenario", setup.scenario.name, *in_options(setup.scenario)]
    return BetterRule(shlex.join(words), found / own.value("rmse_centralised"), sent)
