"""Plots of charts in a browser, thinned to as many points as a screen can show."""

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import viser
from viser import uplot

from concord.dashboard.frames.expected import Expectation
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.chart import Chart, Curve, Drawn, Line, Sample
from concord.dashboard.seeking.time_cursor import READING_STYLE, SYNC
from concord.dashboard.theme import Theme, css
from concord.dashboard.view import View

MOST_POINTS = 600
_LEAST_POWER = -12
_FONT = "11px system-ui, sans-serif"
# Titles and legends take no more of a small screen than they need.
DENSE_STYLE = (
    "<style>.uplot-container{margin:2px 6px!important;padding:0!important}"
    ".u-title{font-size:12px!important;"
    "line-height:15px!important}.u-legend{font-size:10.5px!important;line-height:13px!important;"
    "margin-top:-2px!important}</style>" + READING_STYLE
)

# A low chart that ends just below and above its values has room for one number beside it, or none.
_FROM_ZERO: Any = {"min": {"pad": 0.1, "soft": 0, "mode": 1}, "max": {"pad": 0.1}}
# uplot draws a constant zero on a scale from 0 to 100.
_ZERO: Any = (0.0, 1.0)
# A peak so many times the median of a line asks for a logarithmic scale; a lower one gives it back.
_PEAK, _LOWER_PEAK = 50.0, 25.0


_BEGINNING = (
    '<div style="padding:10px 14px;font-size:12px;opacity:.7">'
    "The charts begin with the second step that this page receives.</div>"
)
_LEAST_WITH_TIME = 100
# A distance of so many usual ones between two points is a gap; a title names a line that has missed
# so many points.
_GAP, _MISSED = 3.0, 10
# A plot is used again after three others, when no browser shows it any more.
_HANDLES = 4


class PlotForm(NamedTuple):
    """All of a plot but its data: uplot draws another plot when one of these changes."""

    title: str
    lines: tuple[int, ...]
    dotted: tuple[bool, ...]
    power: int
    is_logarithmic: bool
    is_zero: bool


class Plot:
    """The uplot of one chart; a line without a single number is left out.

    A new form is a new plot. viser keeps the zoom of a plot relative to its data, and computes it
    from the old range where form and data change at once.
    """

    def __init__(
        self, gui: viser.GuiApi, container: Any, chart: Chart, theme: Theme, height: int, order: int
    ) -> None:
        self._gui, self._container, self._height = gui, container, height
        self._chart, self._theme, self._order = chart, theme, order
        self._form: PlotForm | None = None
        # The last one is shown. viser forgets the zoom of a plot that is hidden; a plot that is
        # removed may still be sent data. Each comes with the properties that a browser has of it.
        self._handles: deque[tuple[Any, dict[str, Any]]] = deque()
        self._times, self._columns = np.zeros(0), [np.zeros(0) for _ in chart.lines]
        self._title = titled(chart.name, chart.unit, 0)

    def _series(self, form: PlotForm) -> tuple[Any, ...]:
        drawn: list[Any] = [uplot.Series(label="time [s]")]
        for index, is_dotted in zip(form.lines, form.dotted, strict=True):
            line = self._chart.lines[index]
            dash: dict[str, Any] = {"dash": (5, 4)} if line.dashed else {}
            stroke = css(line.colour(self._theme))
            points = uplot.Series_Points(show=is_dotted, size=3)
            drawn.append(
                uplot.Series(label=line.name, stroke=stroke, width=1.6, **dash, points=points)
            )
        return tuple(drawn)

    def _axes(self) -> tuple[Any, Any]:
        """Return the axes of time and of the values: their room, and the least space of ticks."""
        line: Any = {"stroke": css(self._theme.faint), "width": 1}
        ticks: Any = {**line, "size": 4}
        named: Any = {"label": "time [s]", "labelSize": 14, "labelGap": 0, "labelFont": _FONT}
        if self._height < _LEAST_WITH_TIME:
            # The first chart names the times of all.
            named = {}
        across, up = (
            uplot.Axis(
                size=size, space=space, gap=3, stroke=css(self._theme.quiet), grid=line,
                ticks=ticks, font=_FONT, **more,
            )
            for size, space, more in ((18, 50, named), (54, 16, {}))
        )  # fmt: skip
        return across, up

    def _add(self, form: PlotForm, data: Any) -> None:
        """Make the plot anew."""
        values: Any = uplot.Scale(auto=True)
        if form.is_logarithmic:
            values = uplot.Scale(auto=True, distr=3, log=10)
        elif form.is_zero:
            values = uplot.Scale(range=_ZERO)
        elif self._chart.from_zero:
            values = uplot.Scale(auto=True, range=_FROM_ZERO)
        shown: dict[str, Any] = {
            "data": data,
            "series": self._series(form),
            "title": form.title,
            "scales": {"x": uplot.Scale(time=False), "y": values},
            "axes": self._axes(),
            "legend": uplot.Legend(show=True, live=True),
            "cursor": SYNC,
        }
        self._hide()
        if len(self._handles) < _HANDLES:
            with self._container:
                # viser makes a plot of arrays alone; the data with its gaps follow at once.
                shown["data"] = tuple(np.zeros(2) for _ in data)
                handle = self._gui.add_uplot(
                    **shown, padding=(8, 14, 0, 0), height=self._height, aspect=2.0,
                    order=self._order,
                )  # fmt: skip
                handle.data = data
        else:
            handle, before = self._handles.popleft()
            for name, value in {**shown, "visible": True}.items():
                if name == "data" or before.get(name) != value:
                    setattr(handle, name, value)
        del shown["data"]
        self._handles.append((handle, shown))
        self._form = form

    def _hide(self) -> None:
        if self._form is not None:
            self._handles[-1][0].visible = False
        self._form = None

    def set_theme(self, theme: Theme) -> None:
        """Repaint the axes and the lines with the next data."""
        self._theme = theme
        self._hide()

    def show(self, sample: Sample) -> None:
        """Assign the data; where a value is missing, the line has a gap.

        A line without values is left out. The plot is not there before the second step: an empty
        one would show zeros.
        """
        if len(sample.times) < 2:
            return
        columns = [line.column(sample) for line in self._chart.lines]
        self._times, self._columns = with_gaps(sample.times, columns)
        present = tuple(i for i, column in enumerate(columns) if np.isfinite(column).any())
        if not present:
            self._hide()
            return
        known = [columns[index][np.isfinite(columns[index])] for index in present]
        was_logarithmic = self._form is not None and self._form.is_logarithmic
        is_logarithmic = self._chart.from_zero and asks_for_logarithm(known, was_logarithmic)
        power = shown_power(known)
        name, unit = self._chart.name, self._chart.unit
        if self._chart.about is not None:
            name, unit = self._chart.about(sample)
        self._title = titled(name, unit, 0)
        title = titled(name, unit, power) + missing_words(self._chart.lines, columns, sample)
        is_zero = not any(column.any() for column in known)
        drawn = [self._columns[index] for index in present]
        dotted = tuple(has_lone_points(column) for column in drawn)
        form = PlotForm(title, present, dotted, power, is_logarithmic, is_zero)
        data = [self._times.tolist(), *(told(10.0**-power * column) for column in drawn)]
        if form == self._form:
            self._handles[-1][0].data = data
        else:
            self._add(form, data)

    @property
    def drawn(self) -> Drawn:
        """Return the chart with the values that it shows last, for an export."""
        curves = (
            Curve(line.name, line.colour(self._theme), line.dashed, values)
            for line, values in zip(self._chart.lines, self._columns, strict=True)
        )
        is_logarithmic = self._form is not None and self._form.is_logarithmic
        return Drawn(self._title, self._times, tuple(curves), is_logarithmic)


def asks_for_logarithm(columns: list[np.ndarray], has_one: bool) -> bool:
    """Say whether positive values have a peak that leaves no height for one of the lines.

    `columns` have the known values of each line.
    """
    if not all((column > 0).all() for column in columns):
        return False
    usual = min(float(np.median(column)) for column in columns)
    return (
        max(float(column.max()) for column in columns) > (_LOWER_PEAK if has_one else _PEAK) * usual
    )


def shown_power(columns: list[np.ndarray]) -> int:
    """Return the power of ten, a multiple of three, in which a plot shows known values.

    uplot writes at most three decimals, so smaller values need a power; beside the plot is room for
    five digits. Values below 10^-12 are rounding errors.
    """
    largest = max(float(np.abs(column).max()) for column in columns)
    if 0.02 <= largest < 1e5 or largest == 0.0:
        return 0
    return max(_LEAST_POWER, 3 * int(np.floor(np.log10(largest) / 3)))


def titled(name: str, unit: str, power: int) -> str:
    """Return a chart's name with its unit and the power of ten of its values."""
    of = powered("", power) + ("" if unit == "1" else f" {unit}")
    return f"{name} [{of.strip()}]" if of else name


def powered(words: str, power: int) -> str:
    """Return words with a power of ten behind them; alone where it is one."""
    return f"{words} 10{str(power).translate(_RAISED)}" if power else words


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def with_gaps(times: np.ndarray, columns: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return times and columns with a missing value where the page lacks several steps in a row.

    The page receives every second step of a network, say: only a distance above `_GAP` times the
    usual one is a gap.
    """
    distances = np.diff(times)
    usual = np.median(distances) if len(distances) else 0.0
    places = np.flatnonzero(distances > _GAP * usual) + 1
    if not len(places):
        return times, columns
    between = (times[places - 1] + times[places]) / 2
    return np.insert(times, places, between), [np.insert(c, places, np.nan) for c in columns]


def has_lone_points(column: np.ndarray) -> bool:
    """Say whether a known value has no known neighbour: a line would not show it."""
    known = np.r_[False, np.isfinite(column), False]
    return bool((known[1:-1] & ~known[:-2] & ~known[2:]).any())


def missing_words(lines: Sequence[Line], columns: list[np.ndarray], sample: Sample) -> str:
    """Return for a title which full lines have ended, and at which step; empty where none has."""
    words = []
    for line, column in zip(lines, columns, strict=True):
        last = int(np.flatnonzero(np.isfinite(column)).max(initial=-1))
        if not line.dashed and 0 <= last < len(column) - _MISSED:
            words.append(f"{line.name}: none since step {sample.frames[last + 1].step}")
    return "".join(f" · {each}" for each in words)


def told(column: np.ndarray) -> list[float | None]:
    """Return values as uplot takes them: it draws a gap for None, and a straight line for NaN."""
    return [
        value if known else None
        for value, known in zip(column.tolist(), np.isfinite(column).tolist(), strict=True)
    ]


class Charts:
    """Plots of some charts below each other."""

    def __init__(
        self,
        gui: viser.GuiApi,
        container: Any,
        charts: Sequence[Chart],
        theme: Theme,
        height: int,
        small_height: int | None = None,
    ) -> None:
        """Make the first chart `height` pixels high, and the others `small_height`."""
        self._plots = [
            Plot(gui, container, chart, theme, (small_height if place > 1 else 0) or height, place)
            for place, chart in enumerate(charts, 1)
        ]
        with container:
            self.beginning: Any = gui.add_html(_BEGINNING, order=0)

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
        self.beginning.visible = len(sample.times) < 2
        for plot in self._plots:
            plot.show(sample)


def sampled(stage: Stage, view: View, history: FrameHistory, expectation: Expectation) -> Sample:
    """Return all steps up to the shown one, thinned to `MOST_POINTS`."""
    window = round(view.window_s / stage.setup.time_step_s) if view.window_s else len(history)
    frames = history.sampled(view.step, MOST_POINTS, max(2, window))
    times = np.array([frame.time_s for frame in frames])
    return Sample(stage, view, frames, times, expectation(times))
