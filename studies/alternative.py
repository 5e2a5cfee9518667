"""An alternative to the rule of a run: labelled measurements, on the same noise and bus."""

from math import isnan

import numpy as np

from concord.filters.metrics import rmse
from concord.results.bus.bus_report import wire_per_step
from concord.results.bus.sent_shares import SentShares
from concord.results.figures.summary import LabelledFigures
from concord.results.records.trace import Trace
from concord.scenarios.build import build_bus
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.rules import MeasurementFlooding
from concord.scenarios.types.schedules import DynamicSchedule, PartialSchedule

# A larger network takes longer than a reader of figures wants to wait: some seconds here.
_MOST_LANE_STEPS = 4_000
_LEAST_SCORED_STEPS = 20
_OCCUPANCY = 0.25


def labelled_beside(setup: Setup, trace: Trace, first_step: int) -> LabelledFigures | None:
    """Return the figures of labelled measurements from a step on, computed by the batched driver.

    None where the rule cannot run, where it would not meet the same noise (a controller acts on
    estimates, or the network was changed), or where it would take long.
    """
    scenario = setup.scenario
    if definition_of(scenario).wirings or is_set_valued(scenario):
        return None
    if isinstance(scenario.rule, MeasurementFlooding):
        return None
    if trace.control is not None or trace.history.changed or scenario.changes:
        return None
    few = trace.steps - first_step < _LEAST_SCORED_STEPS or trace.steps < scenario.steps
    if few or scenario.nodes * scenario.steps > _MOST_LANE_STEPS:
        return None
    try:
        asked, options = _labelled(scenario)
        return _simulated(prepare(asked), options, first_step)
    except (ValueError, ArithmeticError):
        # The sentence of a refusal would answer a question that the user has not asked.
        return None


def _labelled(scenario: Scenario) -> tuple[Scenario, str]:
    """The scenario with the other rule, and the options that say so.

    Static frames of FlexRay are padded to the longest share, so the rule gets dynamic slots.
    """
    options, schedule = "--rule labelled", scenario.bus.schedule
    changed: dict[str, object] = {"rule": "labelled"}
    if isinstance(scenario.bus, FlexRay) and not isinstance(schedule, DynamicSchedule):
        partial = isinstance(schedule, PartialSchedule)
        occupancy = schedule.occupancy if partial else _OCCUPANCY
        changed |= {"schedule": "dynamic", "occupancy": occupancy}
        options += f" --schedule dynamic --occupancy {occupancy:g}"
    if scenario.rule != type(scenario.rule)():
        options += f" (without the options of {scenario.rule.name})"
    return scenario.with_(**changed), options  # pyright: ignore[reportArgumentType]


def _simulated(setup: Setup, options: str, first_step: int) -> LabelledFigures | None:
    # Only here: most commands that print figures simulate nothing.
    from concord.runtime.batched.build import without_array_form
    from concord.studies.monte_carlo.simulate import simulate

    if without_array_form(setup.scenario) is not None:
        return None
    histories = simulate(setup, [setup.scenario.run])
    states = list(definition_of(setup.scenario).score.states)
    errors = histories.mean[0] - histories.truth[0][:, None]
    found = float(rmse(errors[first_step:][..., states], (0, 1)))
    if isnan(found):
        return None
    bus = build_bus(setup)
    sent = SentShares(histories.payload_bytes[0], np.asarray(histories.classes[0]))
    return LabelledFigures(options, found, wire_per_step(bus, sent)[0] if bus.has_time else None)
