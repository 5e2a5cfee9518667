"""Build the drivers' input from a setup: the configuration of one node, or of the environment."""

import dataclasses
from functools import partial

import msgspec
import numpy as np

from concord.bus.bus import Bus
from concord.bus.schedule import Schedule
from concord.bus.timebase import Pace
from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.filters.turns import angles_of
from concord.nodes.changes import UNCHANGED, Standing
from concord.nodes.environment_state import ControlStep, EnvironmentConfig
from concord.nodes.estimator import AnyEstimator, EarlierBelief
from concord.nodes.messages import from_wire
from concord.nodes.node_state import NodeConfig
from concord.scenarios.bus_table.bus_plan import plan_bus
from concord.scenarios.catalogue import definition_of
from concord.scenarios.definitions.closed_loop import control_node
from concord.scenarios.equipment import build_faults, spread_of
from concord.scenarios.filter_table.filters import build_filter, models_of
from concord.scenarios.links import link_state
from concord.scenarios.node_context import Beginning, Everybody, NodeContext, RuleContext
from concord.scenarios.preparation import complete_settings, share_bytes, with_settings
from concord.scenarios.rule_table.rules import (
    build_estimator,
    hold_policy,
    is_set_valued,
    rule_of,
    wire_number,
)
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup, generator
from concord.scenarios.types.buses import stretch_of
from concord.scenarios.types.schedules import trigger_of

# Steps by which an undriven environment may run ahead of the slowest estimate.
OPEN_LOOP_LEAD = 4


def build_bus(setup: Setup, first_step: int = 0, first_cycle: int = 0) -> Bus:
    """The bus of a setup whose settings hold from a step on, which begins with this cycle."""
    scenario = setup.scenario
    step_us = setup.time_step_s * stretch_of(scenario.bus) * 1e6
    pace = Pace(step_us, scenario.rounds, first_step, first_cycle)
    return plan_bus(scenario, share_bytes(setup), setup.neighbours).paced(pace)


def build_node(setup: Setup, node: int) -> NodeConfig:
    """The configuration of one node."""
    return _node(setup, node, UNCHANGED, 0)


def _node(setup: Setup, node: int, standing: Standing, step: int) -> NodeConfig:
    """That of a node which begins at a step, where `setup` holds by what has been set since."""
    scenario = setup.scenario
    bus = build_bus(setup, standing.first_step, standing.first_cycle)
    cycle = standing.first_cycle + (step - standing.first_step) * scenario.rounds
    return NodeConfig(
        node,
        setup.neighbours,
        scenario.rounds,
        scenario.steps,
        bus,
        _estimator(setup, node, bus, Beginning(step, cycle, step > standing.first_step)),
        link_state(setup),
        standing.first_step,
        standing.first_cycle,
        standing,
        partial(_rebuilt, setup, node),
        faults=build_faults(setup, bus),
        scenario_links=link_state(setup),
    )


def _rebuilt(
    setup: Setup, node: int, standing: Standing, step: int, earlier: EarlierBelief | None
) -> NodeConfig:
    """The configuration of a node that begins anew, of a setup whose fields were not set yet.

    Raises:
        ValueError: they cannot be set so.
    """
    if standing.settings:
        complete_settings(setup, {}, standing.settings)
    changed = with_settings(setup, standing.settings)
    # The sensors of a measurement bus believe nothing that a node could begin with.
    if earlier is None and is_set_valued(changed.scenario) and step > 0:
        # Everything that the prior says is of step 0.
        prior = Gaussian(np.array(changed.prior_mean), np.array(changed.prior_cov))
        earlier = EarlierBelief(prior, 0)
    if earlier is not None and not definition_of(changed.scenario).wirings:
        model = definition_of(changed.scenario).model(changed.scenario)
        set_at_step = rule_of(changed.scenario).set_at_step
        if set_at_step is not None:
            belief = set_at_step(earlier, step - 1, model)
        else:
            belief = earlier.at_step(step - 1, model, filter_of(changed))
        changed = msgspec.structs.replace(
            changed, prior_mean=belief.mean.tolist(), prior_cov=belief.cov.tolist()
        )
    config = _node(changed, node, standing, step)
    # A later change of settings applies to the original setup, beside all earlier changes.
    return dataclasses.replace(config, rebuild=partial(_rebuilt, setup, node))


def _estimator(setup: Setup, node: int, bus: Bus, beginning: Beginning) -> AnyEstimator:
    scenario = setup.scenario
    definition = definition_of(scenario)
    wiring = definition.wiring(scenario)
    if wiring is not None:
        return wiring.estimator(setup, node, bus, beginning)
    context = NodeContext(
        node,
        rule_context(setup, any(node in row for row in bus.schedule.contender_table)),
        weights=np.array(setup.weights[node]),
        model=definition.model(scenario),
        sensor=definition.sensor(scenario, node),
        prior=Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov)),
        filter=filter_of(setup),
        everybody=partial(everybody_of, setup, bus.schedule),
        beginning=beginning,
    )
    return build_estimator(scenario, context)


def filter_of(setup: Setup) -> Filter:
    """The filter of the nodes of a setup."""
    scenario = setup.scenario
    points = definition_of(scenario).points
    own = None if points is None else points(scenario)
    return build_filter(scenario.filter, len(setup.prior_mean), own)


def rule_context(setup: Setup, contends: bool) -> RuleContext:
    """Return the context of a setup's rule at nodes that ask for dynamic slots, or do not."""
    scenario = setup.scenario
    return RuleContext(
        len(setup.prior_mean),
        setup.neighbours,
        hold_policy(scenario),
        trigger_of(scenario.bus.schedule),
        wire_number(scenario),
        scenario.rule,
        contends,
        models_of(scenario.filter),
        definition_of(scenario).origin(scenario),
        angles_of(definition_of(scenario).model(scenario)),
    )


def everybody_of(setup: Setup, schedule: Schedule) -> Everybody:
    """Return the knowledge that all nodes have of all nodes."""
    scenario = setup.scenario
    definition = definition_of(scenario)
    plant = definition.plant(scenario)
    noise = plant.draw(partial(generator, scenario), 1).measurement[0]
    _, readings, channels = plant.observe(from_wire(setup.initial_state), noise, 0).shape
    sensors = tuple(definition.sensor(scenario, node) for node in range(scenario.nodes))
    groups = definition.sensor_groups(scenario)
    late, origin = definition.late_steps(scenario), definition.origin(scenario)
    return Everybody(scenario, schedule, sensors, groups, (readings, channels), late, origin)


def build_environment(setup: Setup, standing: Standing = UNCHANGED) -> EnvironmentConfig:
    """Return the configuration of the environment, with all its randomness drawn, where the
    settings hold since when they stand."""
    scenario = setup.scenario
    bus = build_bus(setup, standing.first_step, standing.first_cycle)
    definition = definition_of(scenario)
    plant = definition.plant(scenario)
    controller = build_controller(scenario)
    return EnvironmentConfig(
        plant=plant,
        initial_state=from_wire(setup.initial_state),
        states=len(setup.prior_mean),
        draws=plant.draw(partial(generator, scenario), scenario.steps),
        nodes=scenario.nodes,
        steps=scenario.steps,
        rounds=scenario.rounds,
        lead=OPEN_LOOP_LEAD if controller is None or controller.node is None else 1,
        bus=bus,
        controller=controller,
        delivery=definition.delivery(scenario) if definition.delivery else None,
        neighbours=setup.neighbours,
        rebuild=partial(_environment_rebuilt, setup),
        faults=build_faults(setup, bus),
        spread=partial(spread_of, scenario),
    )


def _environment_rebuilt(setup: Setup, standing: Standing) -> EnvironmentConfig:
    changed = build_environment(with_settings(setup, standing.settings), standing)
    return dataclasses.replace(
        changed,
        first_step=standing.first_step,
        first_cycle=standing.first_cycle,
        rebuild=partial(_environment_rebuilt, setup),
    )


def build_controller(scenario: Scenario) -> ControlStep | None:
    """Return the plant's controller and the node whose belief it uses; None for an open loop."""
    law = definition_of(scenario).controller(scenario)
    if law is None:
        return None
    return ControlStep(law.control, law.initial_memory, control_node(scenario))
