"""Charts of two runs: a line of the other run in each chart, and the difference of the errors."""

from collections.abc import Callable

import numpy as np

from concord.dashboard.comparison.other_run import OtherRun, running_mean
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.panels.chart import Chart, Column, Line, Sample


def compared_charts(
    charts: tuple[Chart, ...], other: OtherRun, history: FrameHistory
) -> tuple[Chart, ...]:
    """Return the charts with a line of the other run in each, and the difference after the first.

    `history` has the frames of the shown run.
    """
    overlaid = [_overlaid(chart, other) for chart in charts]
    return overlaid[0], _difference(charts[0], other, history), *overlaid[1:]


def _overlaid(chart: Chart, other: OtherRun) -> Chart:
    """Add the first line of a chart, as the other run has it."""
    line = chart.lines[0]
    added = Line(other.labels[1], lambda t: t.sending, _of_other(line.column, other))
    renamed = line._replace(name=f"{line.name}, {other.labels[0]}")
    return chart._replace(lines=(renamed, added, *chart.lines[1:]))


def _of_other(column: Column, other: OtherRun) -> Column:
    def values(sample: Sample) -> np.ndarray:
        frames = other.beside(sample.frames)
        there = {frame.step: place for place, frame in enumerate(frames)}
        known = column(sample._replace(frames=frames))
        return np.array(
            [known[there[frame.step]] if frame.step in there else np.nan for frame in sample.frames]
        )

    return values


def _difference(errors: Chart, other: OtherRun, history: FrameHistory) -> Chart:
    """Return the chart of the other run's RMSE less that of the shown run."""

    def of(figure: Callable[[np.ndarray], np.ndarray]) -> Column:
        def values(sample: Sample) -> np.ndarray:
            steps = [frame.step for frame in sample.frames]
            paired = other.paired(history, steps[-1] if steps else -1)
            difference = paired.second["rmse"] - paired.first["rmse"]
            known = np.isfinite(difference)
            found = figure(difference[known])
            by_step = dict(zip(paired.steps[known].tolist(), found.tolist(), strict=True))
            return np.array([by_step.get(step, np.nan) for step in steps], dtype=np.float64)

        return values

    first, second = other.labels
    return Chart(
        f"RMSE, {second} less {first}",
        errors.unit,
        (
            Line("of the step", lambda t: t.estimate, of(lambda d: d)),
            Line("mean so far", lambda t: t.seeing, of(lambda d: running_mean(d)[0])),
            Line("95 % from", lambda t: t.quiet, of(lambda d: running_mean(d)[1]), True),
            Line("to", lambda t: t.quiet, of(lambda d: running_mean(d)[2]), True),
        ),
        from_zero=False,
    )
