"""The trackers of `target-swarm`: their models, and the tracker that has all scans at once."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np

from concord.features.several_targets.association.associate import ASSOCIATIONS
from concord.features.several_targets.options import TargetSwarm
from concord.features.several_targets.scan_codec import ScanCodec
from concord.features.several_targets.scanned_swarm import ScannedSwarm, detections_of
from concord.features.several_targets.scanning import ScanningSensor
from concord.features.several_targets.swarm import Swarm
from concord.features.several_targets.tracking.tracker import Scan, Tracked, TrackerSettings, track
from concord.features.several_targets.tracking.tracks import number_of_targets
from concord.filters.gaussian import Gaussian
from concord.filters.interacting_models import Mode
from concord.filters.sigma_points import cubature
from concord.plants.linear import LinearModel
from concord.plants.motion import TURN_RATE, ConstantVelocity, CoordinatedTurn, Motion
from concord.plants.placement import place_sensors, sites
from concord.plants.range_bearing import RangeBearing
from concord.scenarios.definitions.target_tracking import RADIO_RANGE_M
from concord.scenarios.scenario import FilterChoice, Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.filters import InteractingMultipleModels

UNDETECTED = 0.1
"""Expected number of targets that no sensor has seen yet, as a tracker assumes it in each scan."""
_END_OVER_BIRTH = 0.1
_TURNS_AS_NOISE_M2_S3, _NOISE_M2_S3 = 1.0, 0.05
"""Acceleration densities of a tracker without a model of turns, and with one: 0.1 rad/s at 10 m/s
is an acceleration of 1 m/s²."""
STATES = 1
_KEPT_RUNS = 64


def swarm_of(scenario: Scenario) -> TargetSwarm:
    """The targets and sensors of a scenario."""
    assert isinstance(scenario.plant, TargetSwarm), "the table of scenarios chose it"
    return scenario.plant


@lru_cache(maxsize=8)
def _plant(chosen: TargetSwarm, nodes: int) -> ScannedSwarm:
    where = chosen.placement
    places = (
        sites(where, nodes)
        if isinstance(where, str)
        else place_sensors(nodes, radio_range_m=RADIO_RANGE_M, drawing=where)
    )
    sensors = tuple(
        ScanningSensor(
            RangeBearing(place), chosen.detection, chosen.clutter, merge_m=chosen.merge_m
        )
        for place in places
    )
    return ScannedSwarm(Swarm(chosen.targets), sensors, UNDETECTED)


def plant_of(scenario: Scenario) -> ScannedSwarm:
    """The targets, and the sensors of all nodes."""
    return _plant(swarm_of(scenario), scenario.nodes)


def model_of(scenario: Scenario) -> LinearModel:
    """The number of targets as a random walk."""
    return LinearModel(np.eye(STATES), np.zeros((STATES, 0)), UNDETECTED * np.eye(STATES))


@cache
def _settings(association: str, clutter: float, chosen: FilterChoice) -> TrackerSettings:
    birth = UNDETECTED / (UNDETECTED + clutter)
    motion, changing = _motion(chosen)
    return TrackerSettings(
        lambda states: motion.transition(states, None, 0),
        motion.process_noise_cov(0),
        cubature(len(motion.state_names)),
        ASSOCIATIONS[association],
        birth=birth,
        # A track may lose nine tenths of its first existence, however small that is.
        end_below=_END_OVER_BIRTH * birth,
        **changing,
    )


def _motion(chosen: FilterChoice) -> tuple[Motion, dict[str, Any]]:
    """Return the model of motion of a filter, and the settings of several models."""
    if not isinstance(chosen, InteractingMultipleModels):
        return ConstantVelocity(acceleration_density_m2_s3=_TURNS_AS_NOISE_M2_S3), {}
    std = chosen.turn_rate_std
    changing = {
        "modes": (Mode(held=(TURN_RATE,), std=std), Mode()),
        "change": chosen.change,
        "unseen_std": (std,),
    }
    return CoordinatedTurn(acceleration_density_m2_s3=_NOISE_M2_S3), changing


def settings_of(scenario: Scenario) -> TrackerSettings:
    """Return the settings of a tracker by its filter.

    `ukf` believes in constant velocity, disturbed by the targets' turns; `imm` in straight courses
    and turns.
    """
    chosen = swarm_of(scenario)
    return _settings(chosen.association, chosen.clutter, scenario.filter)


def scans_of(scenario: Scenario, codec: ScanCodec) -> Callable[[int, bytes], Scan]:
    """Return what the record of a node means: its scan, by a sensor that knows of the rounding."""
    sensors = [_as_read(one, codec) for one in plant_of(scenario).sensors]

    def scan(node: int, record: bytes) -> Scan:
        sensor, detections = sensors[node], codec.detections(record)
        if len(detections) == codec.readings:
            # Farther ones may have found no room in the record.
            sensor = dataclasses.replace(sensor, reach_m=float(detections[:, 0].max()))
        return Scan(node, sensor, detections)

    return scan


def _as_read(sensor: ScanningSensor, codec: ScanCodec) -> ScanningSensor:
    """Return the sensor of detections that were rounded."""
    range_std_m, bearing_std_rad = np.sqrt(np.diagonal(sensor.noise_cov + codec.rounding_cov))
    exact = sensor.sensor
    rounded = dataclasses.replace(
        exact, range_std_m=float(range_std_m), bearing_std_rad=float(bearing_std_rad)
    )
    return dataclasses.replace(sensor, sensor=rounded)


def tracked_alone(
    scenario: Scenario, nodes: Sequence[int], readings: np.ndarray
) -> tuple[Tracked, ...]:
    """The tracks after each step of one tracker with all scans (steps, N, 1 + D, 2) of some nodes,
    unrounded."""
    some = np.ascontiguousarray(readings[:, list(nodes)])
    tracker = scenario.filter, swarm_of(scenario), scenario.nodes
    return _tracked(*tracker, tuple(nodes), some.shape, some.tobytes())


@lru_cache(maxsize=_KEPT_RUNS)
def _tracked(
    filter: FilterChoice,
    chosen: TargetSwarm,
    of: int,
    nodes: tuple[int, ...],
    shape: tuple[int, ...],
    scans: bytes,
) -> tuple[Tracked, ...]:
    sensors = _plant(chosen, of).sensors
    settings = _settings(chosen.association, chosen.clutter, filter)
    tracked, found = settings.start, []
    for step, rows in enumerate(np.frombuffer(scans).reshape(shape)):
        taken = [
            Scan(node, sensors[node], detections)
            for node, of_node in zip(nodes, rows, strict=True)
            if (detections := detections_of(of_node)) is not None
        ]
        tracked = track(tracked.tracks, taken, settings, step)
        found.append(tracked)
    return tuple(found)


def baseline_filter(setup: Setup, nodes: Sequence[int], readings: np.ndarray) -> Gaussian:
    """The number of targets after each step by one tracker with all scans of some nodes."""
    numbers = [
        number_of_targets(one.tracks, UNDETECTED)
        for one in tracked_alone(setup.scenario, nodes, readings)
    ]
    return Gaussian(np.stack([one.mean for one in numbers]), np.stack([one.cov for one in numbers]))
