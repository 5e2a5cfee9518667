"""`mrclam`: four real robots track the fifth (UTIAS MRCLAM, any of its data sets)."""

import os
from functools import cache

from concord.features.recorded.confined_motion import ConfinedMotion
from concord.features.recorded.mrclam import RecordedTarget, recorded_target
from concord.features.recorded.mrclam_files import read_recording
from concord.features.recorded.options import RecordedRobots
from concord.features.recorded.sighting import Sighting
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.types.plants import SensorNetwork

DATA_VARIABLE = "CONCORD_MRCLAM"
_NODES = 4


@cache
def _plant(data: str, target: int) -> RecordedTarget:
    return recorded_target(read_recording(data), target)


def _recorded(scenario: Scenario) -> RecordedTarget:
    robots = scenario.plant
    assert isinstance(robots, RecordedRobots), "the catalogue chose this file"
    data = robots.data or os.environ.get(DATA_VARIABLE)
    if data is None:
        raise ValueError(
            "scenario mrclam replays recorded data: name the folder of a data set with --data, or "
            f"with the environment variable {DATA_VARIABLE} (UTIAS MRCLAM, files Barcodes.dat, "
            "Robot1_Groundtruth.dat, ...)"
        )
    return _plant(data, robots.target)


def _check(scenario: Scenario) -> None:
    plant = _recorded(scenario)
    if scenario.nodes != plant.nodes:
        raise ValueError(
            f"--nodes {scenario.nodes}: the recording has {plant.nodes} robots beside the target, "
            "and each is a node; leave --nodes out"
        )
    if scenario.steps > plant.steps:
        raise ValueError(
            f"--steps {scenario.steps}: the recording has {plant.steps} steps of "
            f"{plant.time_step_s:g} s; ask for fewer, or leave --steps out"
        )


def _sensor(_: Scenario, node: int) -> Sighting:
    # The observer's pose is part of what it delivers, so all nodes read alike.
    return Sighting().for_node(node)


DEFINITION = ScenarioDefinition(
    defaults=Scenario(
        plant=RecordedRobots(),
        network=SensorNetwork(nodes=_NODES, graph="complete"),
        rounds=1,
        steps=1,
    ),
    check=_check,
    plant=_recorded,
    model=lambda _: ConfinedMotion(),
    sensor=_sensor,
    sensors=lambda _: Sighting(),
    # Truth has no velocity but a difference of positions, so consistency is of the position too.
    score=Score(states=(0, 1), unit="m", nees_states=(0, 1), first_step=0, near_s=2.0),
    all_steps=lambda scenario: _recorded(scenario).steps,
)
