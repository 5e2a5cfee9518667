"""The plants of the weighted-average-consensus paper, each in a network and under its controller.

`control` says whose knowledge closes the loop: a node's estimate (its number), `truth`, or `open`
for no controller. `noise` is `matched` (physical, what filters believe) or `paper` (as printed).
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from concord.features.control.cruise import cruise, cruise_controller
from concord.features.control.motor import (
    motor_position,
    motor_position_controller,
    motor_speed,
    motor_speed_controller,
)
from concord.features.control.options import (
    AircraftPitch,
    CruiseControl,
    MotorPosition,
    MotorSpeed,
    Suspension,
)
from concord.features.control.pitch import pitch, pitch_controller
from concord.features.control.suspension import suspension, suspension_controller
from concord.plants.linear import LinearPlant
from concord.scenarios.definitions.closed_loop import OPEN, check_control, controlled
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.plants import SensorNetwork

AnyControlled = CruiseControl | Suspension | AircraftPitch | MotorSpeed | MotorPosition


class _Plant(NamedTuple):
    """A plant of the paper: how to make it and its controller, what its error is measured on."""

    plant: AnyControlled
    make: Callable[..., LinearPlant]
    controller: Callable[[], Any]
    scored: int
    unit: str
    states: int
    stretch: float = 1.0


_PLANTS = {
    "cruise-control": _Plant(CruiseControl(), cruise, cruise_controller, 0, "m/s", 1),
    "suspension": _Plant(
        Suspension(),
        suspension,
        suspension_controller,
        2,
        "m",
        4,
        # No FlexRay cycle is as short as its sampling time of half a millisecond.
        stretch=8.0,
    ),
    "aircraft-pitch": _Plant(AircraftPitch(), pitch, pitch_controller, 2, "rad", 3),
    "dc-motor-speed": _Plant(
        MotorSpeed(),
        motor_speed,
        motor_speed_controller,
        0,
        "rad/s",
        2,
    ),
    "dc-motor-position": _Plant(
        MotorPosition(),
        motor_position,
        motor_position_controller,
        0,
        "rad",
        3,
    ),
}


@cache
def _made(name: str, nodes: int, noise: str) -> LinearPlant:
    return _PLANTS[name].make(nodes, noise)


def plant_of(scenario: Scenario) -> LinearPlant:
    """The plant of a scenario, made once."""
    return _made(scenario.name, scenario.nodes, controlled(scenario).noise)


def _warnings(scenario: Scenario) -> tuple[str, ...]:
    warning = plant_of(scenario).warning
    return (warning,) if warning else ()


def _definition(plant: _Plant) -> ScenarioDefinition:
    def controller(scenario: Scenario) -> Any:
        return None if controlled(scenario).control == OPEN else plant.controller()

    return ScenarioDefinition(
        defaults=Scenario(
            plant=plant.plant,
            network=SensorNetwork(nodes=8, graph="ring"),
            bus=FlexRay(stretch=plant.stretch),
            steps=300,
        ),
        check=check_control,
        plant=plant_of,
        model=lambda scenario: plant_of(scenario).model,
        sensor=lambda scenario, node: plant_of(scenario).sensor(node),
        sensors=lambda scenario: plant_of(scenario).sensors,
        score=Score(
            states=(plant.scored,),
            unit=plant.unit,
            nees_states=tuple(range(plant.states)),
            first_step=60,
        ),
        controller=controller,
        warnings=_warnings,
    )


CRUISE_CONTROL, SUSPENSION, AIRCRAFT_PITCH, DC_MOTOR_SPEED, DC_MOTOR_POSITION = map(
    _definition, _PLANTS.values()
)
