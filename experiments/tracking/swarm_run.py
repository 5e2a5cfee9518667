"""One run of `target-swarm`: a centre that has all scans, and nodes that flood them."""

from collections.abc import Sequence

import msgspec
import numpy as np

from concord.experiments.tracking.track_log import TrackingScores, TrackLog
from concord.filters.tracking.tracker import Scan, Tracked, TrackerSettings, track
from concord.filters.tracking.tracks import no_tracks
from concord.nodes.tracking.flooded_scans import WindowTracks, flooded
from concord.scenarios.definitions.target_swarm import STATES, TargetSwarm


class SwarmRun(msgspec.Struct, frozen=True):
    """Figures of one run.

    Attributes:
        centre: scores of the tracker that has all scans at once.
        nodes: scores of the nodes' trackers, means over nodes.
        held: part of all scans of the window that a node holds after a step, mean.
        alike: part of the pairs of nodes whose tracks are equal bit for bit after a step, mean.
        approximated: clusters of the centre that were beyond the bound of the exact sum.
    """

    centre: TrackingScores
    nodes: TrackingScores
    held: float
    alike: float
    approximated: int


def run_swarm(swarm: TargetSwarm) -> SwarmRun:
    """Simulate a run.

    Raises:
        ValueError: options that no swarm can have.
    """
    swarm.check()
    truth, settings = swarm.truth(), swarm.settings()
    scans = swarm.scans(truth)
    centre, approximated = _centre(truth, scans, settings)
    logs = [TrackLog() for _ in range(swarm.nodes)]
    held, alike = [], []
    for step, (part, tracked) in enumerate(_network(swarm, scans, settings)):
        for log, one in zip(logs, tracked, strict=True):
            log.add(truth[step], one.tracks)
        held.append(part)
        alike.append(_pairs_alike(tracked))
    return SwarmRun(
        centre, _mean([log.scores() for log in logs]), float(np.mean(held)),
        float(np.mean(alike)), approximated,
    )  # fmt: skip


def _centre(
    truth: np.ndarray, scans: Sequence[Sequence[Scan]], settings: TrackerSettings
) -> tuple[TrackingScores, int]:
    log, tracked, approximated = TrackLog(), Tracked(no_tracks(STATES), 0), 0
    for step, (states, of_step) in enumerate(zip(truth, scans, strict=True)):
        tracked = track(tracked.tracks, of_step, settings, step)
        log.add(states, tracked.tracks)
        approximated += tracked.approximated
    return log.scores(), approximated


def _network(swarm: TargetSwarm, scans: Sequence[Sequence[Scan]], settings: TrackerSettings):
    """Yield for each step the part of the scans that is held, and the tracks of all nodes."""

    def after(before: Tracked, step: int, held: bytes) -> Tracked:
        taken = np.frombuffer(held, dtype=bool)
        return track(
            before.tracks,
            [scans[step][node] for node in np.flatnonzero(taken).tolist()],
            settings,
            step,
        )

    neighbours, losses = swarm.neighbours(), swarm.losses()
    window = WindowTracks(Tracked(no_tracks(STATES), 0), swarm.nodes, swarm.window_steps, after)
    held = np.zeros((0, swarm.nodes, swarm.nodes), dtype=bool)
    for step in range(swarm.steps):
        newest = np.eye(swarm.nodes, dtype=bool)[None]
        held = np.concatenate((held, newest))[-swarm.window_steps :]
        for _ in range(swarm.rounds):
            heard = neighbours & (losses.random(neighbours.shape) >= swarm.loss)
            held = flooded(held, heard)
        yield float(held.mean()), window.at(step, held)


def _pairs_alike(tracked: Sequence[Tracked]) -> float:
    """Part of the pairs of nodes with equal tracks, bit for bit; 1 for a single node."""
    nodes = len(tracked)
    if nodes == 1:
        return 1.0
    numbers: dict[bytes, int] = {}
    for one in tracked:
        tracks = one.tracks
        parts = (*tracks.belief, tracks.existence, tracks.identity, tracks.confirmed)
        content = b"".join(part.tobytes() for part in parts)
        numbers[content] = numbers.get(content, 0) + 1
    return sum(n * (n - 1) for n in numbers.values()) / (nodes * (nodes - 1))


def _mean(scores: Sequence[TrackingScores]) -> TrackingScores:
    values = np.array([msgspec.structs.astuple(one) for one in scores])
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0).sum(axis=0)
    means = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return TrackingScores(*means.tolist())
