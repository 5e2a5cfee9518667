"""The trackers of `target-swarm`: their models, that of all scans at once, and those of nodes."""

import dataclasses
from collections.abc import Sequence
from functools import cache, lru_cache

import numpy as np

from concord.bus.bus import Bus
from concord.filters.association.associate import ASSOCIATIONS
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import cubature
from concord.filters.tracking.tracker import Scan, Tracked, TrackerSettings, track
from concord.filters.tracking.tracks import no_tracks, number_of_targets
from concord.nodes.belief_codec import BeliefCodec
from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.labelled import LabelledFlooding
from concord.nodes.rules.labelled_frame import LabelledFrameCodec, labelled_bytes, least_limit
from concord.nodes.tracking.scan_codec import ScanCodec, scan_codec
from concord.nodes.tracking.scan_flooding import (
    KeptTracks,
    RecordsAlone,
    ScanFlooding,
    StepRecords,
)
from concord.nodes.tracking.track_codec import TrackCodec
from concord.nodes.tracking.track_exchange import TrackExchange
from concord.plants.linear import LinearModel
from concord.plants.motion import ConstantVelocity
from concord.plants.placement import place_sensors, sites
from concord.plants.range_bearing import RangeBearing
from concord.plants.scanned_swarm import TARGET_STATES, ScannedSwarm, detections_of
from concord.plants.scanning import ScanningSensor
from concord.plants.swarm import Swarm
from concord.scenarios.definitions.target_tracking import RADIO_RANGE_M
from concord.scenarios.filters import build_filter
from concord.scenarios.labelled import choice_of, digest_of, largest_share, window_of
from concord.scenarios.node_context import Beginning
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.plants import TargetSwarm
from concord.scenarios.types.rules import TrackIntersection

START = Tracked(no_tracks(TARGET_STATES), 0)
UNDETECTED = 0.1
"""Expected number of targets that no sensor has seen yet, as a tracker assumes it in each scan."""
_END_OVER_BIRTH = 0.1
_ACCELERATION_DENSITY_M2_S3 = 1.0
"""So much the tracker allows for turns: 0.1 rad/s at 10 m/s is an acceleration of 1 m/s²."""
_STATES = 1
# Nodes of one process are at most so many steps apart.
_LEAD_STEPS = 4
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
    return LinearModel(np.eye(_STATES), np.zeros((_STATES, 0)), UNDETECTED * np.eye(_STATES))


@cache
def _settings(association: str, clutter: float) -> TrackerSettings:
    birth = UNDETECTED / (UNDETECTED + clutter)
    motion = ConstantVelocity(acceleration_density_m2_s3=_ACCELERATION_DENSITY_M2_S3)
    return TrackerSettings(
        lambda states: motion.transition(states, None, 0),
        motion.process_noise_cov(0),
        cubature(TARGET_STATES),
        ASSOCIATIONS[association],
        birth=birth,
        # A track may lose nine tenths of its first existence, however small that is.
        end_below=_END_OVER_BIRTH * birth,
    )


def settings_of(scenario: Scenario) -> TrackerSettings:
    """Return the settings of a tracker: constant velocity, disturbed by the targets' turns."""
    chosen = swarm_of(scenario)
    return _settings(chosen.association, chosen.clutter)


def tracked_alone(
    scenario: Scenario, nodes: Sequence[int], readings: np.ndarray
) -> tuple[Tracked, ...]:
    """The tracks after each step of one tracker with all scans (steps, N, 1 + D, 2) of some nodes,
    unrounded."""
    some = np.ascontiguousarray(readings[:, list(nodes)])
    return _tracked(swarm_of(scenario), scenario.nodes, tuple(nodes), some.shape, some.tobytes())


@lru_cache(maxsize=_KEPT_RUNS)
def _tracked(
    chosen: TargetSwarm, of: int, nodes: tuple[int, ...], shape: tuple[int, ...], scans: bytes
) -> tuple[Tracked, ...]:
    sensors = _plant(chosen, of).sensors
    settings = _settings(chosen.association, chosen.clutter)
    tracked, found = START, []
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


# --- nodes ---------------------------------------------------------------------------------------


def share_bytes(scenario: Scenario) -> int:
    """Length in bytes of the longest share."""
    if isinstance(scenario.rule, TrackIntersection):
        return _track_codec(scenario.rule).size
    return largest_share(scenario, _STATES)


def scan_codec_of(scenario: Scenario) -> ScanCodec:
    """How scans are written.

    Raises:
        ValueError: a share has no room for a detection.
    """
    sensor = plant_of(scenario).sensors[0]
    head = least_limit(scenario.nodes, digest_of(scenario), labelled_bytes(0))
    least, most = sensor.span()
    return scan_codec(least, most, sensor.sensor.noise_std, share_bytes(scenario) - head)


@lru_cache(maxsize=2)
def tracker_of(scenario: Scenario, window_steps: int) -> KeptTracks:
    """Return the tracker of nodes; those of one process share it."""
    return new_tracker(scenario, window_steps)


def new_tracker(
    scenario: Scenario, window_steps: int, arrival: np.random.Generator | None = None
) -> KeptTracks:
    """Return a tracker of nodes that no other node shares.

    `arrival` draws an order of scans and detections, on which nothing may depend.
    """
    codec, settings = scan_codec_of(scenario), settings_of(scenario)
    sensors = [_as_read(one, codec) for one in plant_of(scenario).sensors]

    def after(before: Tracked, step: int, records: StepRecords) -> Tracked:
        scans = [_scan(codec, sensors[source], source, record) for source, record in records]
        if arrival is not None:
            arrival.shuffle(scans)
            scans = [one._replace(detections=arrival.permutation(one.detections)) for one in scans]
        return track(before.tracks, scans, settings, step)

    return KeptTracks(after, window_steps + _LEAD_STEPS)


def _scan(codec: ScanCodec, sensor: ScanningSensor, source: int, record: bytes) -> Scan:
    detections = codec.detections(record)
    if len(detections) == codec.readings:
        # Farther ones may have found no room in the record.
        sensor = dataclasses.replace(sensor, reach_m=float(detections[:, 0].max()))
    return Scan(source, sensor, detections)


def _as_read(sensor: ScanningSensor, codec: ScanCodec) -> ScanningSensor:
    """Return the sensor of detections that were rounded."""
    range_std_m, bearing_std_rad = np.sqrt(np.diagonal(sensor.noise_cov + codec.rounding_cov))
    exact = sensor.sensor
    rounded = dataclasses.replace(
        exact, range_std_m=float(range_std_m), bearing_std_rad=float(bearing_std_rad)
    )
    return dataclasses.replace(sensor, sensor=rounded)


def _track_codec(rule: TrackIntersection) -> TrackCodec:
    return TrackCodec(TARGET_STATES, rule.most_tracks)


def estimator(
    setup: Setup, node: int, bus: Bus, beginning: Beginning
) -> ScanFlooding | TrackExchange:
    """Return the estimator of one node."""
    rule = setup.scenario.rule
    if not isinstance(rule, TrackIntersection):
        return _flooding(setup, node, bus, beginning)
    return TrackExchange(
        node,
        len(setup.neighbours[node]),
        plant_of(setup.scenario).sensors[node],
        settings_of(setup.scenario),
        _track_codec(rule),
        UNDETECTED,
        beginning.step,
    )


def _flooding(setup: Setup, node: int, bus: Bus, beginning: Beginning) -> ScanFlooding:
    scenario, neighbours = setup.scenario, setup.neighbours
    codec, window_steps = scan_codec_of(scenario), window_of(scenario, neighbours)
    codecs = [codec] * scenario.nodes
    frames = LabelledFrameCodec(
        codecs,
        BeliefCodec(_STATES, "<f4"),
        window_steps,
        digest_of(scenario),
        share_bytes(scenario),
    )
    window = RecordsAlone(
        model_of(scenario),
        build_filter(scenario.filter, _STATES),
        AllSensors((), scenario.nodes, (1 + codec.readings, codec.channels)),
        codecs,
    )
    flooding = LabelledFlooding(
        node=node,
        neighbours=neighbours,
        prior=Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov)),
        own=(),
        filter=window,
        frames=frames,
        choice=choice_of(scenario, frames),
        schedule=bus.schedule,
        rounds=scenario.rounds,
        first_step=beginning.step,
        first_cycle=beginning.cycle,
    )
    return ScanFlooding(flooding, tracker_of(scenario, window_steps), START, UNDETECTED)
