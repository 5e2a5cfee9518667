"""The tracks of a run as its recording tells them, and those of baselines."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from concord.features.several_targets.scanned_swarm import paths_of
from concord.features.several_targets.swarm_tracking import settings_of, tracked_alone
from concord.features.several_targets.track_log import TrackLog
from concord.features.several_targets.tracking.tracks import report, report_of
from concord.results.records.extras import Told
from concord.scenarios.setup import Setup


class TracksTrace(NamedTuple):
    """Tracks of the nodes of a run.

    Attributes:
        paths: states (steps, K, 4) of the targets, NaN where one is not there.
        logs: the tracks of each node.
        digests: (records used, all numbers of the tracks) by (step, node), where nodes say them.
    """

    paths: np.ndarray
    logs: tuple[TrackLog, ...]
    digests: Mapping[tuple[int, int], tuple[str, str]]

    def distances(self) -> np.ndarray:
        """GOSPA in m (steps, N), NaN while a node was out."""
        return np.stack([log.distances(len(self.paths)) for log in self.logs], axis=1)

    def digest_numbers(self) -> np.ndarray:
        """The digests as numbers (steps, N, 2), 0 where there is none."""
        found = np.zeros((len(self.paths), len(self.logs), 2), dtype=np.uint64)
        for place, digests in self.digests.items():
            found[place] = [int(one or "0", 16) for one in digests]
        return found


def tracks_trace(setup: Setup, states: np.ndarray, told: Told) -> TracksTrace:
    """Return the tracks that nodes tell beside the plant's states (steps, ...)."""
    paths, digests = paths_of(states), {}
    logs = tuple(TrackLog() for _ in range(setup.scenario.nodes))
    for step, truth in enumerate(paths):
        for node, log in enumerate(logs):
            said = told.get((step, node))
            if said is not None:
                log.add(step, truth, report_of(said.rows))
                digests[step, node] = said.records, said.bits
    return TracksTrace(paths, logs, digests)


def log_alone(
    setup: Setup, nodes: Sequence[int], readings: np.ndarray, paths: np.ndarray
) -> TrackLog:
    """The tracks of one tracker that has all scans (steps, N, 1 + D, 2) of these nodes."""
    log, moments = TrackLog(), settings_of(setup.scenario).models.moments
    for step, tracked in enumerate(tracked_alone(setup.scenario, nodes, readings)):
        log.add(step, paths[step], report(tracked.tracks, moments))
    return log


def distances_of_centre(setup: Setup, tracks: TracksTrace, readings: np.ndarray) -> np.ndarray:
    """GOSPA in m (steps,) of one tracker that has all scans (steps, N, 1 + D, 2)."""
    everybody = range(setup.scenario.nodes)
    return log_alone(setup, everybody, readings, tracks.paths).distances(len(tracks.paths))


def distances_alone(setup: Setup, tracks: TracksTrace, readings: np.ndarray) -> np.ndarray:
    """GOSPA in m (steps, N) of trackers that have the scans (steps, N, 1 + D, 2) of one node."""
    logs = (
        log_alone(setup, [node], readings, tracks.paths) for node in range(setup.scenario.nodes)
    )
    return np.stack([log.distances(len(tracks.paths)) for log in logs], axis=1)
