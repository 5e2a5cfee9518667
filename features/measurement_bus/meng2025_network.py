"""`meng2025-network`: every node estimates behind a measurement bus of its own; they run consensus.

Each node has a cluster of the six sensors of the paper and a FlexRay bus to them. The environment
delivers to a node at each step the measurement that the node's bus transmitted in that slot. The
buses are not synchronised: that of node i is i slots ahead. Between the nodes there is the estimate
bus as in any network, with any rule. The paper names distributed estimation as its future work.
"""

from functools import cache, partial

import numpy as np

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.measurement_bus import MeasurementBus, flexray
from concord.features.measurement_bus.measurement_runs import first_received
from concord.features.measurement_bus.meng2025 import SENSORS, SYSTEM, paper_points
from concord.features.measurement_bus.options import StochasticNetwork
from concord.features.measurement_bus.sensed import SensedPlant, clusters
from concord.features.measurement_bus.stochastic_models import SystemModel, SystemSensor
from concord.nodes.environment_state import Delivery
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.types.plants import SensorNetwork


@cache
def _plant(nodes: int) -> SensedPlant:
    return meng2025.plant(clusters(nodes))


def _transmit(
    bus: MeasurementBus, received: np.ndarray, readings: np.ndarray, step: int
) -> tuple[np.ndarray, np.ndarray]:
    """One slot of every node's bus: ybar (nodes, m) after it, and what was sent (nodes, 1, m)."""
    if step == 0:
        return received, readings
    slots = [
        bus.transmit(step + node, reading, held)
        for node, (reading, held) in enumerate(zip(readings[:, 0], received, strict=True))
    ]
    fresh = np.stack([slot.fresh for slot in slots])
    after = np.stack([slot.received for slot in slots])
    return after, np.where(fresh, after, np.nan)[:, None, :]


def _delivery(scenario: Scenario) -> Delivery:
    bus = MeasurementBus(SYSTEM.sizes, flexray(SENSORS, _static_slots(scenario)))
    received = np.tile(first_received(SYSTEM, meng2025.PRIOR_MEAN), (scenario.nodes, 1))
    return Delivery(partial(_transmit, bus), received)


def _static_slots(scenario: Scenario) -> int:
    assert isinstance(scenario.plant, StochasticNetwork), "the catalogue chose this file"
    slots = scenario.plant.static_slots
    rule = f"in 0..{SENSORS - 1}: at least one of {SENSORS} sensors contends for the dynamic slot"
    require(0 <= slots < SENSORS, "static-slots", slots, rule)
    return slots


def _check(scenario: Scenario) -> None:
    _static_slots(scenario)


DEFINITION = ScenarioDefinition(
    defaults=Scenario(
        plant=StochasticNetwork(), network=SensorNetwork(nodes=8, graph="ring"), steps=101
    ),
    check=_check,
    plant=lambda scenario: _plant(scenario.nodes),
    model=lambda _: SystemModel(SYSTEM),
    sensor=lambda _scenario, _node: SystemSensor(SYSTEM, slice(None)),
    sensors=lambda _: SystemSensor(SYSTEM, slice(None)),
    score=Score(states=(0, 1), unit="1", nees_states=(0, 1), first_step=1),
    points=lambda _: paper_points(),
    delivery=_delivery,
)
