"""Results of tracks: scores of nodes and centre, and nodes with equal records."""

from collections import Counter
from collections.abc import Sequence

import msgspec
import numpy as np

from concord.features.several_targets.track_log import TrackingScores
from concord.features.several_targets.track_variables import (
    read_tracks,
    track_variables,
)
from concord.features.several_targets.tracks_trace import (
    TracksTrace,
    distances_alone,
    distances_of_centre,
    log_alone,
    tracks_trace,
)
from concord.results.records.extras import RunExtras
from concord.scenarios.setup import Setup

_LINES = {
    "localisation_m": "distance of tracked targets {} m",
    "missed": "missed targets {}",
    "false": "false tracks {}",
    "ospa_m": "OSPA {} m",
    "cardinality_error": "error of the number {}",
    "identity_switches": "identity switches {}",
    "steps_to_confirm": "steps to the first track {}",
}


class TrackingFigures(msgspec.Struct, frozen=True):
    """Scores of tracks.

    Attributes:
        nodes: scores of each node. network: their means. centre: those of one tracker with all
            scans.
        alike: part of the pairs of nodes whose tracks are equal bit for bit, mean over steps.
        equal_records: pairs of nodes with equal records up to a step, over all steps.
        differing: those of them whose tracks differ in any bit.
    """

    nodes: list[TrackingScores]
    network: TrackingScores
    centre: TrackingScores
    alike: float
    equal_records: int
    differing: int

    def lines(self) -> list[str]:
        """Return the figures in words."""
        both = self.network, self.centre
        parts = (
            text.format(" / ".join(f"{getattr(one, name):.3g}" for one in both))
            for name, text in _LINES.items()
        )
        equal = f"{self.alike:.1%} of the pairs of nodes have equal tracks, bit for bit"
        if self.equal_records:
            equal += (
                f"; {self.equal_records} had equal records, and the tracks of "
                f"{self.differing} of these differ"
            )
        return [f"tracks (RMSE is that of GOSPA), nodes / centre: {', '.join(parts)}", equal]


def tracking_figures(setup: Setup, tracks: TracksTrace, readings: np.ndarray) -> TrackingFigures:
    """Return the figures of tracks; readings (steps, N, 1 + D, 2)."""
    everybody = range(setup.scenario.nodes)
    nodes = [log.scores() for log in tracks.logs]
    centre = _centre(setup, tracks, readings)
    by_step = [
        [tracks.digests[step, node] for node in everybody if (step, node) in tracks.digests]
        for step in range(len(tracks.paths))
    ]
    pairs = [_pairs([records for records, _ in some if records]) for some in by_step]
    same = [_pairs([both for both in some if both[0]]) for some in by_step]
    alike = [
        _pairs([bits for _, bits in some]) / (len(some) * (len(some) - 1) / 2)
        for some in by_step
        if len(some) > 1
    ]
    return TrackingFigures(
        nodes,
        mean_of(nodes),
        centre,
        float(np.mean(alike)) if alike else 1.0,
        sum(pairs),
        sum(pairs) - sum(same),
    )


_NAMES = {
    "ospa": "ospa_m",
    "missed_targets": "missed",
    "false_tracks": "false",
    "cardinality_error": "cardinality_error",
    "identity_switches": "identity_switches",
    "steps_to_confirm": "steps_to_confirm",
}


def track_figures(
    setup: Setup, runs: Sequence[TracksTrace], readings: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the scores (R,) of nodes, and of one tracker with all scans (R, steps, N, 1 + D, 2),
    by the names of `figure_names.FIGURES`."""
    scores = [
        (mean_of([log.scores() for log in tracks.logs]), _centre(setup, tracks, scans))
        for tracks, scans in zip(runs, readings, strict=True)
    ]
    return {
        f"{name}{whose}": np.array([getattr(one[place], field) for one in scores])
        for place, whose in enumerate(("", "_centralised"))
        for name, field in _NAMES.items()
    }


def _centre(setup: Setup, tracks: TracksTrace, readings: np.ndarray) -> TrackingScores:
    return log_alone(setup, range(setup.scenario.nodes), readings, tracks.paths).scores()


def _pairs(values: Sequence[object]) -> int:
    """Return the number of pairs of equal values."""
    return sum(size * (size - 1) // 2 for size in Counter(values).values())


def mean_of(scores: Sequence[TrackingScores]) -> TrackingScores:
    """Means over trackers; NaN where none has a score."""
    values = np.array([msgspec.structs.astuple(one) for one in scores])
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0).sum(axis=0)
    means = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return TrackingScores(*means.tolist())


EXTRAS = RunExtras(
    read=tracks_trace,
    distances_of_centre=distances_of_centre,
    distances_alone=distances_alone,
    figures=tracking_figures,
    figures_of_runs=track_figures,
    variables=track_variables,
    read_runs=read_tracks,
)
