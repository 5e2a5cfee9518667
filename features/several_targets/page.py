"""The page of several targets: their picture, and the charts of their tracks."""

from collections.abc import Callable

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import OwnPage
from concord.dashboard.panels.chart import Chart, Column, Line, of_frames
from concord.dashboard.scene.legend import Meaning
from concord.dashboard.theme import Theme
from concord.features.several_targets.frames import StepTracks, TracksTold
from concord.features.several_targets.scene import SwarmTracks


def track_charts() -> tuple[Chart, ...]:
    """Return the charts of GOSPA and of two of its parts."""
    return (
        Chart(
            "GOSPA of the tracks",
            "m",
            (
                Line("mean of the nodes", lambda t: t.seeing, _of_nodes(lambda t: t.gospa_m)),
                Line("worst node", lambda t: t.estimate, _of_nodes(lambda t: t.gospa_m, np.max)),
            ),
        ),
        Chart(
            "Missed targets and false tracks, mean of the nodes",
            "1",
            (
                Line("missed targets", lambda t: t.down, _of_nodes(lambda t: t.missed)),
                Line("false tracks", lambda t: t.estimate, _of_nodes(lambda t: t.false)),
            ),
        ),
    )


def _of_nodes(
    score: Callable[[StepTracks], np.ndarray], summary: Callable[..., np.floating] = np.mean
) -> Column:
    """Return the column of a score of the nodes that told one."""

    def value(frame: StepFrame) -> float:
        scores = score(frame.extra)
        told = scores[np.isfinite(scores)]
        return float(summary(told)) if len(told) else np.nan

    return of_frames(value)


def _legend(theme: Theme) -> list[Meaning]:
    return [
        ("\u25cf", theme.truth, "target, with its trail"),
        ("\u2715", theme.fused, "track of the selected node, or of the first, with its number"),
        ("\u25cb", theme.fused, "three standard deviations of a track"),
    ]


PAGE = OwnPage(
    begin=TracksTold,
    errors=lambda tracks: tracks.gospa_m,
    error_name="GOSPA",
    belief_unit="targets",
    charts=track_charts,
    picture=SwarmTracks,
    legend=_legend,
    meanings={
        "GOSPA": "error of the tracks of several targets, with the missed and the false ones; the "
        "cutoff is 50 m",
        "Missed": "true targets without a track, and tracks without a target",
    },
)
