"""From a setup to what the drivers run: the configuration of one node, or of the world."""

from collections.abc import Callable
from functools import partial

import numpy as np

from bus.publication import Slot
from bus.schedule import Schedule, full_publish, round_robin
from filters.gaussian import Gaussian
from filters.sigma_points import scaled_unscented
from nodes.belief_codec import BeliefCodec
from nodes.belief_consensus import BeliefConsensus
from nodes.messages import from_wire
from nodes.share import payload_lengths
from nodes.state_machine import NodeConfig
from nodes.world import WorldConfig
from scenarios.catalogue import kind_of
from scenarios.rules import average_of, hold_policy, wire_number
from scenarios.scenario import Scenario
from scenarios.setup import Setup, generator
from topology.names import unknown_name

# Steps by which an undriven world may run ahead of the slowest estimate.
OPEN_LOOP_LEAD = 4


def build_schedule(scenario: Scenario) -> Schedule:
    """Who may publish when.

    Raises:
        ValueError: there is no such schedule.
    """
    if scenario.schedule not in _SCHEDULES:
        raise unknown_name("schedule", scenario.schedule, _SCHEDULES)
    slots = max(1, round(scenario.occupancy * scenario.nodes))
    return _SCHEDULES[scenario.schedule](scenario.nodes, slots)


_SCHEDULES: dict[str, Callable[[int, int], Schedule]] = {
    "full": lambda nodes, _: full_publish(nodes),
    "round-robin": round_robin,
}


def schedule_names() -> tuple[str, ...]:
    """The schedules there are."""
    return tuple(_SCHEDULES)


def build_node(setup: Setup, node: int) -> NodeConfig:
    """The configuration of one node."""
    scenario = setup.scenario
    kind = kind_of(scenario.name)
    states = len(setup.prior_mean)
    estimator = BeliefConsensus(
        model=kind.model(scenario),
        sensor=kind.sensor(scenario, node),
        prior=Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov)),
        points=scaled_unscented(states),
        average=average_of(scenario),
        hold=hold_policy(scenario),
        weights=np.array(setup.weights[node]),
        codec=BeliefCodec(states, wire_number(scenario)),
    )
    return NodeConfig(
        node,
        tuple(setup.neighbours[node]),
        scenario.rounds,
        scenario.steps,
        build_schedule(scenario),
        partial(_slots, payload_lengths(estimator.share_bytes)),
        estimator,
    )


def _slots(lengths: tuple[int, ...], node: int, _cycle: int) -> tuple[Slot, ...]:
    """Each node its own consecutive frame IDs, whatever the cycle."""
    first = node * len(lengths) + 1
    return tuple(Slot(first + part, length) for part, length in enumerate(lengths))


def build_world(setup: Setup) -> WorldConfig:
    """The configuration of the world, with all its randomness drawn."""
    scenario = setup.scenario
    plant = kind_of(scenario.name).plant(scenario)
    return WorldConfig(
        plant=plant,
        initial_state=from_wire(setup.initial_state),
        draws=plant.draw(partial(generator, scenario), scenario.steps),
        nodes=scenario.nodes,
        steps=scenario.steps,
        rounds=scenario.rounds,
        lead=OPEN_LOOP_LEAD,
        schedule=build_schedule(scenario),
        arbitrate=lambda state, cycle, bids: (state, ()),
        arbiter_state=None,
        controller=None,
    )
