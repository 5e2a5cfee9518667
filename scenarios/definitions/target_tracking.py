"""`target-tracking`: range-bearing sensors with a limited field of view follow one target.

The turning target is the scenario TRACK of the consensus study: nodes on a square kilometre, each
sees a target within 350 m, radio reaches 330 m. By default 12 nodes average by `sharp-ci` in two
bytes a number, and a quarter of them send in a cycle of FlexRay. `target-crossing` is its straight
relative.
"""

from collections.abc import Callable
from functools import cache

from concord.plants.placement import place_sensors, sites_by_step
from concord.plants.range_bearing import RangeBearing
from concord.plants.targets import Target, straight_target, turning_target
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.plants import (
    PlacedSensors,
    SensorNetwork,
    TargetCrossing,
    TargetTracking,
)
from concord.scenarios.types.rules import SharpCovarianceIntersection
from concord.scenarios.types.schedules import DynamicSchedule

RADIO_RANGE_M = 330.0


@cache
def _target(make: Callable[..., Target], nodes: int, placement: int | str) -> Target:
    if isinstance(placement, str):
        return make(*sites_by_step(placement, nodes))
    return make(place_sensors(nodes, radio_range_m=RADIO_RANGE_M, drawing=placement))


def _made(make: Callable[..., Target], scenario: Scenario) -> Target:
    plant = scenario.plant
    assert isinstance(plant, PlacedSensors)
    return _target(make, scenario.nodes, plant.placement)


def _check(scenario: Scenario) -> None:
    # Placing the sensors is what can fail, and says why.
    _made(turning_target, scenario)


def _definition(
    plant: TargetTracking | TargetCrossing, make: Callable[..., Target], states: int
) -> ScenarioDefinition:
    def sensor(scenario: Scenario, node: int) -> RangeBearing:
        return _made(make, scenario).sensor(node)

    return ScenarioDefinition(
        defaults=Scenario(
            plant=plant,
            network=SensorNetwork(nodes=12, graph="geometric"),
            steps=120,
            rule=SharpCovarianceIntersection(number="float16"),
            bus=FlexRay(schedule=DynamicSchedule(occupancy=0.25)),
        ),
        check=_check,
        plant=lambda scenario: _made(make, scenario),
        model=lambda scenario: _made(make, scenario).model,
        sensor=sensor,
        sensors=lambda scenario: _made(make, scenario).sensors,
        score=Score(states=(0, 2), unit="m", nees_states=tuple(range(states)), first_step=20),
        radio_range_m=RADIO_RANGE_M,
    )


TURNING = _definition(
    TargetTracking(),
    turning_target,
    states=5,
)
CROSSING = _definition(
    TargetCrossing(),
    straight_target,
    states=4,
)
