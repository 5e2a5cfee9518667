"""One run of `target-swarm`: a centre that has all scans, and nodes that flood them."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import msgspec
import numpy as np

from concord.experiments.tracking.lone_nodes import LoneNodes, PairsCompared, bits_of
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
        compared: pairs of nodes with equal scans, where each node computed alone.
    """

    centre: TrackingScores
    nodes: TrackingScores
    held: float
    alike: float
    approximated: int
    compared: PairsCompared | None


def run_swarm(swarm: TargetSwarm, alone: bool = False) -> SwarmRun:
    """Simulate a run; `alone` lets each node compute its own tracks, and compares their bits.

    Raises:
        ValueError: options that no swarm can have.
    """
    swarm.check()
    truth, settings = swarm.truth(), swarm.settings()
    scans = swarm.scans(truth)
    centre, approximated = _centre(truth, scans, settings)
    logs = [TrackLog() for _ in range(swarm.nodes)]
    held, alike = [], []
    nodes = (_lone_nodes if alone else _nodes)(swarm, scans, settings)
    for step, (part, tracked) in enumerate(_network(swarm, nodes)):
        for log, one in zip(logs, tracked, strict=True):
            log.add(truth[step], one.tracks)
        held.append(part)
        alike.append(_pairs_alike(tracked))
    return SwarmRun(
        centre, _mean([log.scores() for log in logs]), float(np.mean(held)),
        float(np.mean(alike)), approximated,
        nodes.compared() if isinstance(nodes, LoneNodes) else None,
    )  # fmt: skip


def _centre(
    truth: np.ndarray, scans: Sequence[Sequence[Scan]], settings: TrackerSettings
) -> tuple[TrackingScores, int]:
    log, tracked, approximated = TrackLog(), START, 0
    for step, (states, of_step) in enumerate(zip(truth, scans, strict=True)):
        tracked = track(tracked.tracks, of_step, settings, step)
        log.add(states, tracked.tracks)
        approximated += tracked.approximated
    return log.scores(), approximated


START = Tracked(no_tracks(STATES), 0)
Scans = Sequence[Sequence[Scan]]  # of each step and node


def _nodes(swarm: TargetSwarm, scans: Scans, settings: TrackerSettings) -> WindowTracks:
    return WindowTracks(START, swarm.nodes, swarm.window_steps, _tracker(scans, settings))


def _lone_nodes(swarm: TargetSwarm, scans: Scans, settings: TrackerSettings) -> LoneNodes:
    """Nodes that share nothing; each reads scans and detections in an order of its own."""
    trackers = [
        _tracker(scans, settings, swarm.stream("arrival", node)) for node in range(swarm.nodes)
    ]
    return LoneNodes(START, swarm.window_steps, trackers)


def _tracker(
    scans: Scans, settings: TrackerSettings, arrival: np.random.Generator | None = None
) -> Callable[[Tracked, int, bytes], Tracked]:
    """Return the tracker of a node, in the order of nodes unless `arrival` draws another one."""

    def after(before: Tracked, step: int, held: bytes) -> Tracked:
        taken = np.flatnonzero(np.frombuffer(held, dtype=bool))
        if arrival is not None:
            arrival.shuffle(taken)
        read = [scans[step][node] for node in taken.tolist()]
        if arrival is not None:
            read = [one._replace(detections=arrival.permutation(one.detections)) for one in read]
        return track(before.tracks, read, settings, step)

    return after


def _network(
    swarm: TargetSwarm, nodes: WindowTracks | LoneNodes
) -> Iterator[tuple[float, list[Tracked]]]:
    """Yield for each step the part of the scans that is held, and the tracks of all nodes."""
    neighbours, losses = swarm.neighbours(), swarm.stream("loss", 0)
    held = np.zeros((0, swarm.nodes, swarm.nodes), dtype=bool)
    for step in range(swarm.steps):
        newest = np.eye(swarm.nodes, dtype=bool)[None]
        held = np.concatenate((held, newest))[-swarm.window_steps :]
        for _ in range(swarm.rounds):
            heard = neighbours & (losses.random(neighbours.shape) >= swarm.loss)
            held = flooded(held, heard)
        yield float(held.mean()), nodes.at(step, held)


def _pairs_alike(tracked: Sequence[Tracked]) -> float:
    """Part of the pairs of nodes with equal tracks, bit for bit; 1 for a single node."""
    nodes = len(tracked)
    if nodes == 1:
        return 1.0
    numbers = Counter(bits_of(one) for one in tracked)
    return sum(n * (n - 1) for n in numbers.values()) / (nodes * (nodes - 1))


def _mean(scores: Sequence[TrackingScores]) -> TrackingScores:
    values = np.array([msgspec.structs.astuple(one) for one in scores])
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0).sum(axis=0)
    means = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return TrackingScores(*means.tolist())
