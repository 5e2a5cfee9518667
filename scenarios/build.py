"""From a setup to what the drivers run: the configuration of one node, or of the world."""

from functools import partial

import numpy as np

from bus.arbitration import ArbiterState
from bus.schedule import Schedule
from filters.gaussian import Gaussian
from filters.sigma_points import scaled_unscented
from nodes.estimator import Estimator
from nodes.messages import from_wire
from nodes.state_machine import NodeConfig
from nodes.world import Controller, WorldConfig
from scenarios.bus_plan import BusPlan, arbitrate, plan_bus
from scenarios.catalogue import kind_of
from scenarios.control import control_node
from scenarios.estimators import Seat
from scenarios.labelled import Everybody
from scenarios.links import link_state
from scenarios.rules import build_estimator, hold_policy, wire_number
from scenarios.scenario import Scenario
from scenarios.setup import Setup, generator, share_bytes

# Steps by which an undriven world may run ahead of the slowest estimate.
OPEN_LOOP_LEAD = 4


def build_plan(setup: Setup) -> BusPlan:
    """The bus of a setup."""
    return plan_bus(setup.scenario, share_bytes(setup), setup.neighbours)


def build_node(setup: Setup, node: int) -> NodeConfig:
    """The configuration of one node."""
    scenario = setup.scenario
    plan = build_plan(setup)
    return NodeConfig(
        node,
        tuple(setup.neighbours[node]),
        scenario.rounds,
        scenario.steps,
        plan.schedule,
        plan.slots,
        _estimator(setup, node, plan.schedule),
        plan.cycle_counts,
        link_state(setup),
    )


def _estimator(setup: Setup, node: int, schedule: Schedule) -> Estimator:
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
        everybody=partial(_everybody, setup, schedule),
    )
    rule = build_estimator(scenario, seat)
    return kind.around(scenario, seat, rule) if kind.around else rule


def _everybody(setup: Setup, schedule: Schedule) -> Everybody:
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
    )


def build_controller(scenario: Scenario) -> Controller | None:
    """What closes the loop of the plant, and through whose knowledge; None for an open loop."""
    law = kind_of(scenario.name).controller(scenario)
    if law is None:
        return None
    return Controller(law.control, law.initial_memory, control_node(scenario))
