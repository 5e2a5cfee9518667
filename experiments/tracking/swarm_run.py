"""One run of `target-swarm`: a centre that has all scans, and nodes that flood them over a bus."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from concord.bus.bus import Bus
from concord.experiments.tracking.equal_records import (
    PairsCompared,
    bits_of,
    pairs_alike,
    pairs_with_equal_records,
)
from concord.experiments.tracking.swarm_network import START, swarm_network
from concord.experiments.tracking.track_file import CENTRE, write_tracks
from concord.experiments.tracking.track_log import TrackingScores, TrackLog
from concord.filters.tracking.tracker import Scan, TrackerSettings, track
from concord.nodes.changes import Welcome
from concord.nodes.messages import NodeEvent
from concord.nodes.node_state import NodeConfig, NodeState
from concord.nodes.rules.record_sets import flags_of
from concord.nodes.tracking.scan_flooding import ScanContent
from concord.runtime import in_process
from concord.scenarios.definitions.target_swarm import TargetSwarm
from concord.scenarios.script import script_of


class SwarmRun(msgspec.Struct, frozen=True):
    """Figures of one run.

    Attributes:
        centre: scores of the tracker that has all scans at once, unrounded.
        nodes: scores of the nodes' trackers, means over nodes.
        held: part of all scans of the window that a node holds after a step, mean.
        alike: part of the pairs of nodes whose tracks are equal bit for bit after a step, mean.
        approximated: clusters of the centre that were beyond the bound of the exact sum.
        frames, bytes: what the nodes send in a step, mean; the bytes of whole frames.
        bus_time: part of the time for which cycles with shares last; 0 on a bus without time.
        shortened: scans with more detections than a record holds.
        compared: pairs of nodes with equal records, where each node computed alone.
    """

    centre: TrackingScores
    nodes: TrackingScores
    held: float
    alike: float
    approximated: int
    frames: float
    bytes: float
    bus_time: float
    shortened: int
    compared: PairsCompared | None


def run_swarm(swarm: TargetSwarm, alone: bool = False, folder: Path | None = None) -> SwarmRun:
    """Simulate a run, and write its tracks into a `folder`.

    `alone` lets each node compute its own tracks, and compares their bits.

    Raises:
        ValueError: options that no swarm can have.
        NotWritten: the disk does not take the tracks.
    """
    swarm.check()
    truth, settings = swarm.truth(), swarm.settings()
    scans = swarm.scans(truth)
    centre, approximated = _centre(truth, scans, settings)
    network = swarm_network(swarm, truth, scans, settings, alone)
    watch, sent = _Watch(truth, swarm.nodes), _Sent()
    states = in_process.run(
        network.environment,
        network.nodes,
        sent,
        watch=watch,
        script=script_of(swarm.network()),
    )
    if folder is not None:
        write_tracks(folder, swarm, truth, {CENTRE: centre, **dict(enumerate(watch.logs))})
    steps = [watch.steps[step] for step in sorted(watch.steps)]
    compared = [pairs_with_equal_records(one.evidence, one.bits) for one in steps]
    return SwarmRun(
        centre.scores(),
        mean_of([log.scores() for log in watch.logs if log.reported]),
        float(np.mean([part for one in steps for part in one.held])),
        float(np.mean([pairs_alike(one.bits) for one in steps])),
        approximated,
        sent.frames / swarm.steps,
        sent.bytes / swarm.steps,
        _bus_time(swarm, network.environment.bus),
        sum(state.counters.get("record-range", 0) for state in states),
        PairsCompared(
            sum(one.pairs for one in compared), sum(one.different for one in compared)
        ) if alone else None,
    )  # fmt: skip


def _centre(
    truth: np.ndarray, scans: Sequence[Sequence[Scan]], settings: TrackerSettings
) -> tuple[TrackLog, int]:
    log, tracked, approximated = TrackLog(), START, 0
    for step, (states, of_step) in enumerate(zip(truth, scans, strict=True)):
        tracked = track(tracked.tracks, of_step, settings, step)
        log.add(step, states, tracked.tracks)
        approximated += tracked.approximated
    return log, approximated


def _bus_time(swarm: TargetSwarm, bus: Bus) -> float:
    return swarm.rounds * bus.cycle_us / (swarm.setup().time_step_s * 1e6)


class _Sent:
    """A recorder that counts the frames of nodes, and their bytes."""

    def __init__(self) -> None:
        self.frames = self.bytes = 0

    def record(self, messages: Sequence[tuple[str, bytes]]) -> None:
        for topic, data in messages:
            if topic.startswith("share/"):
                self.frames += 1
                self.bytes += len(data)

    def close(self) -> None:
        pass


class _Step(NamedTuple):
    """Nodes after a step, in the order in which they ended it.

    Attributes:
        evidence: digests of the records that they used. bits: their tracks.
        held: part of the scans of the window that they hold.
    """

    evidence: list[bytes]
    bits: list[bytes]
    held: list[float]


class _Watch:
    """Reads the tracks of each node as its step ends."""

    def __init__(self, truth: np.ndarray, nodes: int) -> None:
        self.logs = [TrackLog() for _ in range(nodes)]
        self.steps: dict[int, _Step] = {}
        self._truth, self._nodes = truth, nodes
        self._last: dict[int, bytes] = {}

    def __call__(self, config: NodeConfig, event: NodeEvent | Welcome, state: NodeState) -> None:
        content: ScanContent = state.content
        if isinstance(event, Welcome) or content.evidence in (b"", self._last.get(config.index)):
            return
        # The digest has changed with each step that ended.
        self._last[config.index] = content.evidence
        windows = content.flooded.windows
        flags = flags_of(content.flooded.held, self._nodes)[windows.first :]
        step = windows.step
        self.logs[config.index].add(step, self._truth[step], content.reached.tracks)
        ended = self.steps.setdefault(step, _Step([], [], []))
        ended.evidence.append(content.evidence)
        ended.bits.append(bits_of(content.reached))
        ended.held.append(float(flags.mean()))


def mean_of(scores: Sequence[TrackingScores]) -> TrackingScores:
    """Means over trackers; NaN where none has a score."""
    values = np.array([msgspec.structs.astuple(one) for one in scores])
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0).sum(axis=0)
    means = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return TrackingScores(*means.tolist())
