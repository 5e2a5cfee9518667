"""Charts over time: error, disagreement, consistency, traffic, one state; thinned to what a screen
can show."""

from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from viser import uplot

from dashboard.frame import Array
from dashboard.history import History
from dashboard.stage import Stage
from dashboard.theme import Colour, Theme, css
from dashboard.view import View

MOST_POINTS = 600
Band = Callable[[Array], tuple[Array, Array] | None]


class Chart:
    """One uplot with named lines; a line without a single number is drawn as nothing."""

    def __init__(
        self, gui: viser.GuiApi, title: str, lines: dict[str, Colour], theme: Theme, height: int,
        dashed: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        self.title, self._lines, self._dashed = title, lines, dashed
        self._present = list(range(len(lines)))
        nothing = np.array([0.0, 1.0])
        self._handle: Any = gui.add_uplot(
            data=(nothing, *(nothing * 0 for _ in lines)),
            series=self._series(),
            title=title,
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale(auto=True)},
            axes=(self._axis(theme, 36), self._axis(theme, 54)),
            legend=uplot.Legend(show=True, live=False),
            padding=(4, 10, 0, 0),
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

    def _axis(self, theme: Theme, size: int) -> Any:
        return uplot.Axis(
            size=size,
            stroke=css(theme.quiet),
            grid={"stroke": css(theme.faint), "width": 1},
            ticks={"stroke": css(theme.faint), "width": 1},
        )

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
        self._handle.axes = (self._axis(theme, 36), self._axis(theme, 54))
        self._handle.series = self._series()

    def show(self, times: Array, columns: list[Array]) -> None:
        """Assign the data; a line without a number is left out, and so are numbers not there."""
        if len(times) < 2:
            return
        self.rows = (times, *columns)
        present = [index for index, column in enumerate(columns) if np.isfinite(column).any()]
        if not present:
            return
        if present != self._present:
            self._present = present
            self._handle.series = self._series()
        self._handle.data = (times, *(_bridged(times, columns[index]) for index in present))


def _bridged(times: Array, column: Array) -> Array:
    """Straight lines where numbers are missing: a NaN would leave the whole chart without scale."""
    known = np.isfinite(column)
    return column if known.all() else np.interp(times, times[known], column[known])


def chart_lines(stage: Stage, theme: Theme) -> dict[str, dict[str, Colour]]:
    """The charts by title, each with its lines and their colours."""
    unit = stage.score.unit
    return {
        f"RMSE of the nodes [{unit}]": {
            "nodes": theme.seeing, "fused": theme.fused, "centralised": theme.truth,
            "its own √tr P": theme.quiet,
        },
        f"Disagreement of the nodes [{unit}]": {"rms spread": theme.estimate},
        "NEES, mean of the nodes": {
            "NEES": theme.sending, "95 % of runs from": theme.quiet, "to": theme.quiet,
        },
        "Payload on the bus [kB/s]": {"payload": theme.seeing},
    }  # fmt: skip


class Charts:
    """The charts of the run and of one state."""

    def __init__(self, gui: viser.GuiApi, stage: Stage, theme: Theme, height: int) -> None:
        self._stage = stage
        dashed = ("its own √tr P", "95 % of runs from", "to")
        self._charts = [
            Chart(gui, title, lines, theme, height, dashed)
            for title, lines in chart_lines(stage, theme).items()
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

    def draw(self, view: View, history: History, band: Band) -> None:
        """Everything up to the shown step."""
        times, columns = history.columns(view.step, MOST_POINTS)
        nees = columns["nees"]
        limits = band(times) or (np.full_like(nees, np.nan),) * 2
        rate = columns["payload_bytes"] / self._stage.setup.time_step_s / 1e3
        kept = [
            [columns["rmse"], columns["fused"], columns["central"], columns["bound"]],
            [columns["spread"]],
            [nees, *limits],
            [rate],
        ]
        for chart, rows in zip(self._charts, kept, strict=True):
            chart.show(times, rows)


class StateChart:
    """One state: the truth, what a node believes, and three deviations around it."""

    _LINES = ("truth", "node", "−3σ", "+3σ")

    def __init__(self, gui: viser.GuiApi, stage: Stage, theme: Theme, height: int) -> None:
        self._stage = stage
        self._chart = Chart(gui, "State", self._colours(theme), theme, height, ("−3σ", "+3σ"))
        self._error = Chart(
            gui, "Error", {"error": theme.estimate, "−3σ": theme.quiet, "+3σ": theme.quiet},
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
