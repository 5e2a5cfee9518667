"""The chart of NIS: how well the nodes' own readings fit their predictions, also without truth."""

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.panels.chart import Chart, Line, Sample, of_frames
from concord.nodes.rules.labelled.self_check import chi_square_bound

_TAILS = (0.025, 0.975)


def nis_chart() -> Chart:
    """NIS per degree of freedom of all nodes and of the selected one, and where 95 % of all are."""
    return Chart(
        "NIS, 1 is right",
        "1",
        (
            Line("nodes", lambda t: t.estimate, of_frames(lambda f: _nis(f, None))),
            Line("selected", lambda t: t.seeing, _of_selected),
            Line("95 % of steps from", lambda t: t.quiet, lambda s: _bound(s, _TAILS[0]), True),
            Line("to", lambda t: t.quiet, lambda s: _bound(s, _TAILS[1]), True),
        ),
    )


def _nis(frame: StepFrame, node: int | None) -> float:
    nis = frame.scores.nis
    return float("nan") if nis is None else nis.of(node)


def _of_selected(sample: Sample) -> np.ndarray:
    node = sample.view.selected
    if node is None:
        return np.full(len(sample.frames), np.nan)
    return np.array([_nis(frame, node) for frame in sample.frames])


def _bound(sample: Sample, tail: float) -> np.ndarray:
    """The quantile of NIS of all readings of a step, if they are independent.

    In closed form, as scipy takes a quarter of a second to load: off by at most 0.012 from three
    degrees of freedom on.
    """
    freedoms = np.array(
        [
            0 if frame.scores.nis is None else frame.scores.nis.freedoms.sum()
            for frame in sample.frames
        ]
    )
    counts = np.maximum(freedoms, 1)
    bound = np.maximum(0.0, chi_square_bound(counts, 1 - tail)) / counts
    return np.where(freedoms > 0, bound, np.nan)
