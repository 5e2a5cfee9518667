"""Charts of the tracks of several targets."""

from collections.abc import Callable

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.panels.chart import Chart, Column, Line, of_frames
from concord.features.several_targets.frames import StepTracks


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
        if frame.tracks is None:
            return np.nan
        scores = score(frame.tracks)
        told = scores[np.isfinite(scores)]
        return float(summary(told)) if len(told) else np.nan

    return of_frames(value)
