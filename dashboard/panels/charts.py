"""Plots of charts in a browser, thinned to as many points as a screen can show."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
from viser import uplot

from concord.dashboard.frames.expected import Expectation
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.chart import Chart, Curve, Drawn, Sample
from concord.dashboard.theme import Theme, css
from concord.dashboard.view import View

MOST_POINTS = 600
_LEAST_POWER = -12
# Titles and legends take no more of a small screen than they need.
DENSE_STYLE = (
    "<style>.uplot-container{margin:3px 6px!important}.u-title{font-size:12px!important;"
    "line-height:15px!important}.u-legend{font-size:10.5px!important;line-height:13px!important;"
    "margin-top:-2px!important}</style>"
)

# A low chart that ends just below and above its values has room for one number beside it, or none.
_FROM_ZERO: Any = {"min": {"pad": 0.1, "soft": 0, "mode": 1}, "max": {"pad": 0.1}}


class Plot:
    """The uplot of one chart; a line without a single number is left out."""

    def __init__(self, gui: viser.GuiApi, chart: Chart, theme: Theme, height: int) -> None:
        self._chart, self._theme = chart, theme
        self._power = 0
        self._present = list(range(len(chart.lines)))
        self._times, self._columns = np.zeros(0), [np.zeros(0) for _ in chart.lines]
        nothing = np.array([0.0, 1.0])
        scale = (
            uplot.Scale(auto=True, range=_FROM_ZERO) if chart.from_zero else uplot.Scale(auto=True)
        )
        self._handle: Any = gui.add_uplot(
            data=(nothing, *(nothing * 0 for _ in chart.lines)),
            series=self._series(),
            title=titled(chart, 0),
            scales={"x": uplot.Scale(time=False), "y": scale},
            axes=self._axes(),
            legend=uplot.Legend(show=True, live=False),
            padding=(8, 14, 0, 0),
            height=height,
            aspect=2.0,
        )

    def _series(self) -> tuple[Any, ...]:
        drawn: list[Any] = [uplot.Series(label="time [s]")]
        for index in self._present:
            line = self._chart.lines[index]
            dash: dict[str, Any] = {"dash": (5, 4)} if line.dashed else {}
            stroke, points = css(line.colour(self._theme)), uplot.Series_Points(show=False)
            drawn.append(
                uplot.Series(label=line.name, stroke=stroke, width=1.6, **dash, points=points)
            )
        return tuple(drawn)

    def _axes(self) -> tuple[Any, Any]:
        """Return the axes of time and of the values: their room, and the least space of ticks."""
        line: Any = {"stroke": css(self._theme.faint), "width": 1}
        across, up = (
            uplot.Axis(size=size, space=space, stroke=css(self._theme.quiet), grid=line, ticks=line)
            for size, space in ((28, 50), (48, 16))
        )
        return across, up

    def set_theme(self, theme: Theme) -> None:
        """Repaint the axes and the lines."""
        self._theme = theme
        self._handle.axes = self._axes()
        self._handle.series = self._series()

    def show(self, sample: Sample) -> None:
        """Assign the data; missing values are bridged, and a line without values is left out."""
        if len(sample.times) < 2:
            return
        columns = [line.column(sample) for line in self._chart.lines]
        self._times, self._columns = sample.times, columns
        present = [index for index, column in enumerate(columns) if np.isfinite(column).any()]
        self._handle.visible = bool(present)
        if not present:
            return
        if present != self._present:
            self._present = present
            self._handle.series = self._series()
        drawn = [_bridged(sample.times, columns[index]) for index in present]
        power = shown_power(drawn)
        if power != self._power:
            self._power = power
            self._handle.title = titled(self._chart, power)
        self._handle.data = (sample.times, *(10.0**-power * column for column in drawn))

    @property
    def drawn(self) -> Drawn:
        """Return the chart with the values that it shows last, for an export."""
        curves = (
            Curve(line.name, line.colour(self._theme), line.dashed, values)
            for line, values in zip(self._chart.lines, self._columns, strict=True)
        )
        return Drawn(titled(self._chart, 0), self._times, tuple(curves))


def shown_power(columns: list[np.ndarray]) -> int:
    """Return the power of ten, a multiple of three, in which a plot shows values.

    uplot writes at most three decimals, so smaller values need a power. Values below 10^-12 are
    rounding errors.
    """
    largest = max(float(np.abs(column).max()) for column in columns)
    if largest >= 0.02 or largest == 0.0:
        return 0
    return max(_LEAST_POWER, 3 * int(np.floor(np.log10(largest) / 3)))


def titled(chart: Chart, power: int) -> str:
    """Return a chart's name with its unit and the power of ten of its values."""
    exponent = f"10{str(power).translate(_RAISED)} " if power else ""
    of = exponent + ("" if chart.unit == "1" else chart.unit)
    return f"{chart.name} [{of.strip()}]" if of else chart.name


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _bridged(times: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Straight lines where numbers are missing: a NaN would leave the whole chart without scale."""
    known = np.isfinite(column)
    return column if known.all() else np.interp(times, times[known], column[known])


class Charts:
    """Plots of some charts below each other."""

    def __init__(
        self, gui: viser.GuiApi, charts: Sequence[Chart], theme: Theme, height: int
    ) -> None:
        self._plots = [Plot(gui, chart, theme, height) for chart in charts]

    def set_theme(self, theme: Theme) -> None:
        """Repaint."""
        for plot in self._plots:
            plot.set_theme(theme)

    @property
    def drawn(self) -> list[Drawn]:
        """Return the charts with the values that they show."""
        return [plot.drawn for plot in self._plots]

    def draw(self, sample: Sample) -> None:
        """Show every step of a sample."""
        for plot in self._plots:
            plot.show(sample)


def sampled(stage: Stage, view: View, history: FrameHistory, expectation: Expectation) -> Sample:
    """Return all steps up to the shown one, thinned to `MOST_POINTS`."""
    frames = history.sampled(view.step, MOST_POINTS)
    times = np.array([frame.time_s for frame in frames])
    return Sample(stage, view, frames, times, expectation(times))
