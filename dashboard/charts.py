"""Charts over time: error, disagreement, consistency, traffic, one state; thinned to what a screen
can show."""

from typing import Any

import numpy as np
import viser
from viser import uplot

from dashboard.expected import Expectation
from dashboard.frame import Array
from dashboard.history import History
from dashboard.stage import Stage
from dashboard.theme import Colour, Theme, css
from dashboard.view import View

MOST_POINTS = 600
_LEAST_POWER = -12
# Titles and legends take no more of a small screen than they need.
_DENSE = (
    "<style>.uplot-container{margin:3px 6px!important}.u-title{font-size:12px!important;"
    "line-height:15px!important}.u-legend{font-size:10.5px!important;line-height:13px!important;"
    "margin-top:-2px!important}</style>"
)

# A low chart that ends just below and above its values has room for one number beside it, or none.
_FROM_ZERO: Any = {"min": {"pad": 0.1, "soft": 0, "mode": 1}, "max": {"pad": 0.1}}


class Chart:
    """One uplot with named lines; a line without a single number is drawn as nothing."""

    def __init__(
        self, gui: viser.GuiApi, name: str, unit: str, lines: dict[str, Colour], theme: Theme,
        height: int, dashed: tuple[str, ...] = (), from_zero: bool = False,
    ) -> None:  # fmt: skip
        self._name, self._unit, self._lines, self._dashed = name, unit, lines, dashed
        self._power = 0
        self._present = list(range(len(lines)))
        nothing = np.array([0.0, 1.0])
        scale = uplot.Scale(auto=True, range=_FROM_ZERO) if from_zero else uplot.Scale(auto=True)
        self._handle: Any = gui.add_uplot(
            data=(nothing, *(nothing * 0 for _ in lines)),
            series=self._series(),
            title=self.title,
            scales={"x": uplot.Scale(time=False), "y": scale},
            axes=self._axes(theme),
            legend=uplot.Legend(show=True, live=False),
            padding=(8, 14, 0, 0),
            height=height,
            aspect=2.0,
        )
        self.rows: tuple[Array, ...] = ()

    def _series(self) -> tuple[Any, ...]:
        lines = list(self._lines.items())
        drawn: list[Any] = [uplot.Series(label="time [s]")]
        for index in self._present:
            name, colour = lines[index]
            line: dict[str, Any] = {"label": name, "stroke": css(colour), "width": 1.6}
            if name in self._dashed:
                line["dash"] = (5, 4)
            drawn.append(uplot.Series(**line, points={"show": False}))
        return tuple(drawn)

    def _axes(self, theme: Theme) -> tuple[Any, Any]:
        """Of time and of the values: how much room they take, how near to each other ticks are."""
        line: Any = {"stroke": css(theme.faint), "width": 1}
        across, up = (
            uplot.Axis(size=size, space=space, stroke=css(theme.quiet), grid=line, ticks=line)
            for size, space in ((28, 50), (48, 16))
        )
        return across, up

    @property
    def title(self) -> str:
        """Of the values as they are."""
        return titled(self._name, self._unit, 0)

    @property
    def dashed(self) -> tuple[str, ...]:
        """Names of the lines that are."""
        return self._dashed

    @property
    def names(self) -> list[str]:
        """Of the lines."""
        return list(self._lines)

    @property
    def colours(self) -> list[Colour]:
        """Of the lines."""
        return list(self._lines.values())

    def set_theme(self, theme: Theme, lines: dict[str, Colour]) -> None:
        """Repaint."""
        self._lines = lines
        self._handle.axes = self._axes(theme)
        self._handle.series = self._series()

    def show(self, times: Array, columns: list[Array]) -> None:
        """Assign the data; a line without a number is left out, and so are numbers not there."""
        if len(times) < 2:
            return
        self.rows = (times, *columns)
        present = [index for index, column in enumerate(columns) if np.isfinite(column).any()]
        self._handle.visible = bool(present)
        if not present:
            return
        if present != self._present:
            self._present = present
            self._handle.series = self._series()
        drawn = [_bridged(times, columns[index]) for index in present]
        power = shown_power(drawn)
        if power != self._power:
            self._power = power
            self._handle.title = titled(self._name, self._unit, power)
        self._handle.data = (times, *(10.0**-power * column for column in drawn))


def shown_power(columns: list[Array]) -> int:
    """The power of ten, a multiple of three, in which values are shown that uplot would round to
    nothing: it writes three decimals at most. What is smaller still is rounding."""
    largest = max(float(np.abs(column).max()) for column in columns)
    if largest >= 0.02 or largest == 0.0:
        return 0
    return max(_LEAST_POWER, 3 * int(np.floor(np.log10(largest) / 3)))


def titled(name: str, unit: str, power: int) -> str:
    """A name with its unit, and the power of ten that is part of it."""
    exponent = f"10{str(power).translate(_RAISED)} " if power else ""
    of = exponent + ("" if unit == "1" else unit)
    return f"{name} [{of.strip()}]" if of else name


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _bridged(times: Array, column: Array) -> Array:
    """Straight lines where numbers are missing: a NaN would leave the whole chart without scale."""
    known = np.isfinite(column)
    return column if known.all() else np.interp(times, times[known], column[known])


def chart_lines(stage: Stage, theme: Theme) -> dict[tuple[str, str], dict[str, Colour]]:
    """The charts by name and unit, each with its lines and their colours."""
    unit = stage.score.unit
    return {
        ("RMSE of the nodes", unit): {
            "nodes": theme.seeing, stage.fused_name: theme.fused, "centralised": theme.text,
            "Cramér-Rao bound": theme.quiet,
        },
        ("Disagreement of the nodes", unit): {"rms spread": theme.estimate},
        ("NEES, mean of the nodes", "1"): {
            "NEES": theme.estimate, "95 % of runs from": theme.quiet, "to": theme.quiet,
        },
        ("Payload on the bus", "kB/s"): {"payload": theme.seeing},
    }  # fmt: skip


class Charts:
    """The charts of the run and of one state."""

    def __init__(self, gui: viser.GuiApi, stage: Stage, theme: Theme, height: int) -> None:
        self._stage = stage
        gui.add_html(_DENSE)
        dashed = ("Cramér-Rao bound", "95 % of runs from", "to")
        self._charts = [
            Chart(gui, name, unit, lines, theme, height, dashed, from_zero=True)
            for (name, unit), lines in chart_lines(stage, theme).items()
        ]

    def set_theme(self, theme: Theme) -> None:
        """Repaint."""
        for chart, lines in zip(
            self._charts, chart_lines(self._stage, theme).values(), strict=True
        ):
            chart.set_theme(theme, lines)

    @property
    def drawn(self) -> list[Chart]:
        """The charts with what they show."""
        return self._charts

    def draw(self, view: View, history: History, expectation: Expectation) -> None:
        """Everything up to the shown step."""
        times, columns = history.columns(view.step, MOST_POINTS)
        expected = expectation(times)
        rate = columns["payload_bytes"] / self._stage.setup.time_step_s / 1e3
        kept = [
            [columns["rmse"], columns["fused"], columns["central"], expected.bound],
            [columns["spread"]],
            [columns["nees"], expected.nees_low, expected.nees_high],
            [rate],
        ]
        for chart, rows in zip(self._charts, kept, strict=True):
            chart.show(times, rows)


class StateChart:
    """One state: the truth, what a node believes, and three deviations around it."""

    _LINES = ("truth", "node", "−3σ", "+3σ")

    def __init__(self, gui: viser.GuiApi, stage: Stage, theme: Theme, height: int) -> None:
        self._stage = stage
        self._chart = Chart(gui, "State", "1", self._colours(theme), theme, height, ("−3σ", "+3σ"))
        self._error = Chart(
            gui, "Error", "1", {"error": theme.estimate, "−3σ": theme.quiet, "+3σ": theme.quiet},
            theme, height, ("−3σ", "+3σ"),
        )  # fmt: skip

    def _colours(self, theme: Theme) -> dict[str, Colour]:
        return dict(
            zip(self._LINES, (theme.truth, theme.estimate, theme.quiet, theme.quiet), strict=True)
        )

    def draw(self, view: View, history: History) -> None:
        """The chosen state of the selected node, the first where none is."""
        node = view.selected or 0
        times, table = history.states(view.step, MOST_POINTS, node, view.state)
        truth, mean, deviation = table.T
        reach = self._stage.deviations * deviation
        self._chart.show(times, [truth, mean, mean - reach, mean + reach])
        self._error.show(times, [mean - truth, -reach, reach])
