"""The network of a swarm: environment and nodes whose readings are scans, over a bus."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.bus.bus import Bus
from concord.filters.gaussian import Gaussian
from concord.filters.tracking.tracker import Scan, Tracked, TrackerSettings, track
from concord.filters.tracking.tracks import no_tracks
from concord.nodes.belief_codec import BeliefCodec
from concord.nodes.changes import Standing
from concord.nodes.earlier_belief import EarlierBelief
from concord.nodes.environment_state import EnvironmentConfig
from concord.nodes.node_state import NodeConfig
from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.labelled import LabelledFlooding
from concord.nodes.rules.labelled_frame import LabelledFrameCodec, labelled_bytes, least_limit
from concord.nodes.tracking.scan_codec import ScanCodec, scan_codec, scan_rows
from concord.nodes.tracking.scan_flooding import (
    KeptTracks,
    RecordsAlone,
    ScanFlooding,
    StepRecords,
    TrackStep,
)
from concord.plants.draws import Draws
from concord.plants.scanning import ScanningSensor
from concord.scenarios.build import build_environment, build_node, filter_of
from concord.scenarios.catalogue import definition_of
from concord.scenarios.definitions.target_swarm import STATES, TargetSwarm
from concord.scenarios.labelled import choice_of, digest_of, window_of
from concord.scenarios.preparation import share_bytes
from concord.scenarios.setup import Setup

START = Tracked(no_tracks(STATES), 0)
# The number of targets is what the estimates of these nodes say.
_NUMBER_OF_TARGETS = Gaussian(np.zeros(1), np.eye(1))
# Steps by which a node may be behind another one.
_LEAD = 1


class SwarmNetwork(NamedTuple):
    """Configurations of the environment and of all nodes."""

    environment: EnvironmentConfig
    nodes: list[NodeConfig]


class _ScannedGround(NamedTuple):
    """The plant of the environment: `readings` (steps, N, r, d), and targets there (steps,)."""

    readings: np.ndarray
    targets: np.ndarray

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        return self.targets[step + 1 : step + 2]

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        return self.readings[step]


def swarm_network(
    swarm: TargetSwarm,
    truth: np.ndarray,
    scans: Sequence[Sequence[Scan]],
    settings: TrackerSettings,
    alone: bool = False,
) -> SwarmNetwork:
    """Build the network of a swarm with these scans of each step and node.

    Nodes that compute `alone` share no result, and read detections in an order of their own.
    """
    setup, sensors = swarm.setup(), swarm.sensors()
    codec = _codec(setup, sensors[0])
    sensors = [_as_read(one, codec) for one in sensors]
    tracker = partial(_tracker, swarm, codec, sensors, settings)
    shared = tracker()
    nodes = []
    for node in range(swarm.nodes):
        own = tracker(swarm.stream("arrival", node)) if alone else shared
        nodes.append(_with_scans(build_node(setup, node), partial(_estimator, setup, codec, own)))
    return SwarmNetwork(_environment(setup, codec, truth, scans), nodes)


def _tracker(
    swarm: TargetSwarm,
    codec: ScanCodec,
    sensors: Sequence[ScanningSensor],
    settings: TrackerSettings,
    arrival: np.random.Generator | None = None,
) -> KeptTracks:
    """Return the tracker of nodes.

    `arrival` draws an order of scans and detections, on which nothing may depend.
    """

    def after(before: Tracked, step: int, records: StepRecords) -> Tracked:
        scans = [_scan(codec, sensors[source], source, record) for source, record in records]
        if arrival is not None:
            arrival.shuffle(scans)
            scans = [one._replace(detections=arrival.permutation(one.detections)) for one in scans]
        return track(before.tracks, scans, settings, step)

    return KeptTracks(after, swarm.window_steps + _LEAD)


def _scan(codec: ScanCodec, sensor: ScanningSensor, source: int, record: bytes) -> Scan:
    detections = codec.detections(record)
    if len(detections) == codec.readings:
        # Farther ones may have found no room in the record.
        sensor = dataclasses.replace(sensor, reach_m=float(detections[:, 0].max()))
    return Scan(source, sensor, detections)


def _codec(setup: Setup, sensor: ScanningSensor) -> ScanCodec:
    head = least_limit(setup.scenario.nodes, digest_of(setup.scenario), labelled_bytes(0))
    least, most = sensor.span()
    return scan_codec(least, most, sensor.sensor.noise_std, share_bytes(setup) - head)


def _as_read(sensor: ScanningSensor, codec: ScanCodec) -> ScanningSensor:
    """Return the sensor of detections that were rounded."""
    range_std_m, bearing_std_rad = np.sqrt(np.diagonal(sensor.noise_cov + codec.rounding_cov))
    exact = sensor.sensor
    rounded = dataclasses.replace(
        exact, range_std_m=float(range_std_m), bearing_std_rad=float(bearing_std_rad)
    )
    return dataclasses.replace(sensor, sensor=rounded)


def _estimator(
    setup: Setup, codec: ScanCodec, tracker: TrackStep, node: int, bus: Bus, step: int, cycle: int
) -> ScanFlooding:
    scenario, neighbours = setup.scenario, setup.neighbours
    codecs = [codec] * scenario.nodes
    frames = LabelledFrameCodec(
        codecs,
        BeliefCodec(len(_NUMBER_OF_TARGETS.mean), "<f4"),
        window_of(scenario, neighbours),
        digest_of(scenario),
        share_bytes(setup),
    )
    window = RecordsAlone(
        definition_of(scenario).model(scenario),
        filter_of(setup),
        AllSensors((), scenario.nodes, (1 + codec.readings, codec.channels)),
        codecs,
    )
    flooding = LabelledFlooding(
        node=node,
        neighbours=neighbours,
        prior=_NUMBER_OF_TARGETS,
        own=(),
        filter=window,
        frames=frames,
        choice=choice_of(scenario, frames),
        schedule=bus.schedule,
        rounds=scenario.rounds,
        first_step=step,
        first_cycle=cycle,
    )
    return ScanFlooding(flooding, tracker, START)


def _with_scans(config: NodeConfig, estimator: Callable[..., ScanFlooding]) -> NodeConfig:
    """Return a node of the network of `target-tracking` with the estimator of scans."""

    def rebuilt(standing: Standing, step: int, _: EarlierBelief | None) -> NodeConfig:
        assert config.rebuild is not None
        again = config.rebuild(standing, step, None)
        cycle = again.first_cycle + (step - again.first_step) * again.rounds
        return dataclasses.replace(
            again, estimator=estimator(config.index, again.bus, step, cycle), rebuild=rebuilt
        )

    first = estimator(config.index, config.bus, config.first_step, config.first_cycle)
    return dataclasses.replace(config, estimator=first, rebuild=rebuilt)


def _environment(
    setup: Setup, codec: ScanCodec, truth: np.ndarray, scans: Sequence[Sequence[Scan]]
) -> EnvironmentConfig:
    rows = max(codec.readings, *(len(one.detections) for some in scans for one in some))
    readings = np.array([[scan_rows(one.detections, rows) for one in some] for some in scans])
    targets = np.isfinite(truth).all(axis=-1).sum(axis=-1).astype(float)
    nothing = np.zeros((setup.scenario.steps, 0))
    return dataclasses.replace(
        build_environment(setup),
        plant=_ScannedGround(readings, targets),
        initial_state=targets[:1],
        states=len(_NUMBER_OF_TARGETS.mean),
        draws=Draws(np.zeros(0), nothing, nothing),
        lead=_LEAD,
        spread=partial(_spread, scans[0][0].sensor.noise_cov),
    )


def _spread(noise_cov: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """Standard deviations of readings (N, 1 + D, d): the number of detections has none."""
    spread = np.broadcast_to(np.sqrt(np.diagonal(noise_cov)), readings.shape).copy()
    spread[:, 0] = 0
    return spread
