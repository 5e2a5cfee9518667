"""From a setup to what the drivers run: the configuration of one node, or of the world."""

import dataclasses
from functools import partial

import msgspec
import numpy as np

from bus.arbitration import ArbiterState
from bus.schedule import Schedule
from filters.gaussian import Gaussian
from filters.sigma_points import scaled_unscented
from nodes.changes import UNCHANGED, Standing
from nodes.estimator import Estimator
from nodes.messages import from_wire
from nodes.node_state import NodeConfig
from nodes.world import Controller, WorldConfig
from scenarios.bus_plan import BusPlan, arbitrate, plan_bus
from scenarios.catalogue import kind_of
from scenarios.control import control_node
from scenarios.equipment import build_faults, spread_of
from scenarios.estimators import Beginning, Seat
from scenarios.labelled import Everybody
from scenarios.links import link_state
from scenarios.rules import build_estimator, hold_policy, wire_number
from scenarios.scenario import Scenario
from scenarios.setup import Setup, complete_settings, generator, share_bytes, with_settings

# Steps by which an undriven world may run ahead of the slowest estimate.
OPEN_LOOP_LEAD = 4


def build_plan(setup: Setup) -> BusPlan:
    """The bus of a setup."""
    return plan_bus(setup.scenario, share_bytes(setup), setup.neighbours)


def build_node(setup: Setup, node: int) -> NodeConfig:
    """The configuration of one node."""
    return _node(setup, node, UNCHANGED, 0)


def _node(setup: Setup, node: int, standing: Standing, step: int) -> NodeConfig:
    """That of a node which begins at a step, where `setup` holds by what has been set since."""
    scenario = setup.scenario
    plan = build_plan(setup)
    cycle = standing.first_cycle + (step - standing.first_step) * scenario.rounds
    return NodeConfig(
        node,
        tuple(setup.neighbours[node]),
        scenario.rounds,
        scenario.steps,
        plan.schedule,
        plan.slots,
        _estimator(setup, node, plan.schedule, Beginning(step, cycle)),
        plan.cycle_counts,
        link_state(setup),
        standing.first_step,
        standing.first_cycle,
        standing,
        partial(_rebuilt, setup, node),
        faults=build_faults(setup, plan),
        scenario_links=link_state(setup),
    )


def _rebuilt(
    setup: Setup, node: int, standing: Standing, step: int, belief: Gaussian | None
) -> NodeConfig:
    """The configuration of a node that begins anew, of a setup whose fields were not set yet.

    Raises:
        ValueError: they cannot be set so.
    """
    if standing.settings:
        complete_settings(setup, standing.settings)
    changed = with_settings(setup, standing.settings)
    if belief is not None:
        changed = msgspec.structs.replace(
            changed, prior_mean=belief.mean.tolist(), prior_cov=belief.cov.tolist()
        )
    config = _node(changed, node, standing, step)
    # What is set next is set beside what was set before.
    return dataclasses.replace(config, rebuild=partial(_rebuilt, setup, node))


def _estimator(setup: Setup, node: int, schedule: Schedule, beginning: Beginning) -> Estimator:
    scenario = setup.scenario
    kind = kind_of(scenario.name)
    if kind.wiring is not None:
        return kind.wiring.estimator(setup, node)
    seat = Seat(
        node,
        setup.neighbours,
        weights=np.array(setup.weights[node]),
        model=kind.model(scenario),
        sensor=kind.sensor(scenario, node),
        prior=Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov)),
        points=kind.points(scenario) if kind.points else scaled_unscented(len(setup.prior_mean)),
        hold=hold_policy(scenario),
        trigger=scenario.trigger,
        number=wire_number(scenario),
        liars=scenario.liars,
        everybody=partial(everybody_of, setup, schedule),
        beginning=beginning,
    )
    rule = build_estimator(scenario, seat)
    return kind.around(scenario, seat, rule) if kind.around else rule


def everybody_of(setup: Setup, schedule: Schedule) -> Everybody:
    """What every node knows of all nodes."""
    scenario = setup.scenario
    kind = kind_of(scenario.name)
    plant = kind.plant(scenario)
    noise = plant.draw(partial(generator, scenario), 1).measurement[0]
    _, readings, channels = plant.observe(from_wire(setup.initial_state), noise, 0).shape
    sensors = tuple(kind.sensor(scenario, node) for node in range(scenario.nodes))
    return Everybody(scenario, schedule, sensors, (readings, channels))


def build_world(setup: Setup) -> WorldConfig:
    """The configuration of the world, with all its randomness drawn."""
    scenario = setup.scenario
    plan = build_plan(setup)
    kind = kind_of(scenario.name)
    plant = kind.plant(scenario)
    controller = build_controller(scenario)
    return WorldConfig(
        plant=plant,
        initial_state=from_wire(setup.initial_state),
        states=len(setup.prior_mean),
        draws=plant.draw(partial(generator, scenario), scenario.steps),
        nodes=scenario.nodes,
        steps=scenario.steps,
        rounds=scenario.rounds,
        lead=OPEN_LOOP_LEAD if controller is None or controller.node is None else 1,
        schedule=plan.schedule,
        arbitrate=arbitrate(scenario, plan),
        arbiter_state=ArbiterState(),
        controller=controller,
        delivery=kind.delivery(scenario) if kind.delivery else None,
        neighbours=setup.neighbours,
        rebuild=partial(_world_rebuilt, setup),
        faults=build_faults(setup, plan),
        spread=partial(spread_of, scenario),
    )


def _world_rebuilt(setup: Setup, standing: Standing) -> WorldConfig:
    changed = build_world(with_settings(setup, standing.settings))
    return dataclasses.replace(
        changed,
        first_step=standing.first_step,
        first_cycle=standing.first_cycle,
        rebuild=partial(_world_rebuilt, setup),
    )


def build_controller(scenario: Scenario) -> Controller | None:
    """What closes the loop of the plant, and through whose knowledge; None for an open loop."""
    law = kind_of(scenario.name).controller(scenario)
    if law is None:
        return None
    return Controller(law.control, law.initial_memory, control_node(scenario))
