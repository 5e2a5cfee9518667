"""The panels of the page and the scene: made once, drawn again with every picture."""

from collections.abc import Callable
from html import escape
from typing import Any

import numpy as np

from concord.dashboard.bridge import Bridge
from concord.dashboard.comparison.compared_charts import compared_charts
from concord.dashboard.comparison.other_run import OtherRun
from concord.dashboard.comparison.ratio_table import ratio_table
from concord.dashboard.explain.help import help_panel
from concord.dashboard.explain.selected import selected_panel
from concord.dashboard.explain.tooltips import tooltips
from concord.dashboard.failures import PanelFailures
from concord.dashboard.frames.conditions import sender_at
from concord.dashboard.frames.expected import Expectation
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.provenance import STEPS_BACK
from concord.dashboard.frames.stage import PlantDrawing, Stage
from concord.dashboard.inputs import Inputs, at_once
from concord.dashboard.layout import lay_out
from concord.dashboard.panels.chart_table import run_charts, state_charts
from concord.dashboard.panels.charts import DENSE_STYLE, Charts, sampled
from concord.dashboard.panels.run_strip import MOST_BINS, RunStrip
from concord.dashboard.panels.states import states
from concord.dashboard.panels.table import log, node_table
from concord.dashboard.panels.timeline import RASTER_ROWS, TimelineView, past_cycles
from concord.dashboard.panels.zoom import zoom
from concord.dashboard.scene.ghost import Ghost
from concord.dashboard.scene.plants import TRAIL
from concord.dashboard.scene.scene import Scene
from concord.dashboard.seeking.time_cursor import TimeCursor
from concord.dashboard.theme import Theme, css
from concord.dashboard.touch.script import script_panel
from concord.dashboard.view import View
from concord.dashboard.window import PageServer

_CHART_HEIGHT, _SMALL_HEIGHT, _STATE_CHART_HEIGHT = 150, 62, 190
_CAR_TRAIL = 3000


class Page:
    """All pictures of the page: pure functions make them, and this class assigns them.

    Everything is computed before `atomic()`, inside which properties are only assigned.
    """

    def __init__(
        self,
        window: PageServer,
        inputs: Inputs,
        stage: Stage,
        view: View,
        failures: PanelFailures,
        history: FrameHistory,
        other: OtherRun | None = None,
    ) -> None:
        self._window, self._inputs = window, inputs
        self._attempt, self._other = failures.attempt, other
        self._drawn: dict[str, str] = {}
        self._extent = (0, -1)
        self._wanted_step: int | None = None
        self._time_step_s = stage.setup.time_step_s
        gui, nodes = window.server.gui, stage.nodes
        panels = lay_out(window.server, stage.picture is not PlantDrawing.PLANE, other is not None)
        with panels.charts:
            gui.add_html(DENSE_STYLE + tooltips(stage), order=0)
        charts = run_charts(stage)
        if other is not None:
            charts = compared_charts(charts, other, history)
            with panels.ratios:
                self._ratios: Any = gui.add_html("")
            self._ghost = Ghost(window.server.scene, stage)
        self.charts = Charts(gui, panels.charts, charts, view.theme, _CHART_HEIGHT, _SMALL_HEIGHT)
        self._state_charts = Charts(
            gui, panels.state, state_charts(), view.theme, _STATE_CHART_HEIGHT
        )
        with panels.log:
            self._log: Any = gui.add_html("")
        with panels.nodes:
            self._table = Bridge(gui, nodes, inputs.select, inputs.point)
        with panels.selected:
            self._selected: Any = gui.add_html("")
        with panels.help:
            self._help: Any = gui.add_html("")
        with panels.bus:
            self._bus = Bridge(gui, nodes, inputs.select, inputs.point)
            self._strip = RunStrip()
            self._run = Bridge(gui, MOST_BINS, self._seek, lambda _: None)
            TimeCursor(gui, self._seek_time, self._seek_first)
            self.slider: Any = gui.add_slider("Step", 0, 1, 1, 0)
            # Beside the bus, which no window minimizes.
            self._told: Any = gui.add_html("")
        with panels.zoom:
            self._zoom = Bridge(gui, nodes, inputs.select, inputs.point)
        with panels.states:
            self._states: Any = gui.add_html("")
        self.slider.on_update(at_once(self._scrub))
        self._timeline = TimelineView(stage)
        self.scene = Scene(window.server.scene, stage, view.theme, inputs.select)
        window.aim(self.scene, panels)

    def _seek_first(self, step: int) -> None:
        """Show the step of an address as soon as it has come."""
        self._wanted_step = step
        self.set_extent(*self._extent)

    def set_extent(self, first_step: int, last_step: int) -> None:
        """Let people choose among these steps."""
        self._extent = first_step, last_step
        wanted = self._wanted_step
        if wanted is not None and last_step >= wanted:
            self._wanted_step = None
            self._inputs.alter(lambda view: view.look_at(wanted))
        self._inputs.show(self.slider, max=max(1, last_step), min=first_step)

    def _scrub(self, _: Any) -> None:
        step = int(self.slider.value)
        self._inputs.alter(lambda view: view.look_at(step))

    def _seek(self, number: int) -> None:
        step = self._strip.step_of(number)
        self._inputs.alter(lambda view: view.look_at(step))

    def _seek_time(self, time_s: float) -> None:
        if np.isfinite(time_s):
            step = round(time_s / self._time_step_s)
            self._inputs.alter(lambda view: view.look_at(step))

    def draw_scene(self, view: View, history: FrameHistory) -> None:
        """Draw the scene and the timeline of the shown cycle."""
        frame = history.at(view.step)
        cycle = frame.cycles[min(int(view.cursor), len(frame.cycles) - 1)]
        sender, now_us = sender_at(frame, view.cursor)
        trail = _CAR_TRAIL if frame.stage.picture is PlantDrawing.TRACK else TRAIL
        tail = history.until(frame.step, trail)
        assign = self._attempt("Scene", lambda: self.scene.draw(view, frame, tail, sender))

        def timeline() -> str:
            past = past_cycles(history.until(view.step, RASTER_ROWS + 1), cycle)
            return self._timeline.draw(view.theme, frame, past, cycle, now_us, view.selected)

        bus = self._attempt("Bus", timeline)
        ghost = self._attempt("Ghost", lambda: self._ghosts(view, frame, trail))
        with self._window.server.atomic():
            for picture in (assign, ghost):
                if picture is not None:
                    self._attempt("Scene", picture)
            if bus is not None:
                self.show("Bus", self._bus, bus)
        self._inputs.show(self.slider, value=frame.step)

    def _ghosts(self, view: View, frame: StepFrame, trail: int) -> Callable[[], None] | None:
        """Return what draws the other run at the shown step, if there is one."""
        other = self._other
        if other is None:
            return None
        past = other.history.until(frame.step, trail) if len(other.history) else []
        return self._ghost.draw(view, frame, other.at(frame.step), past)

    def draw_panels(self, view: View, history: FrameHistory, expectation: Expectation) -> None:
        """Draw tables, charts and the log, up to the shown step."""
        # First, as a chart of another theme is hidden until its next data.
        self._repaint(view.theme)
        frame = history.at(view.step)
        stage, past = frame.stage, history.until(frame.step, STEPS_BACK)
        events = [event for event in reversed(history.log) if event.step <= view.step]
        panels: dict[str, tuple[Any, Callable[[], str]]] = {
            "Run": (
                self._run, lambda: self._strip.draw(stage, view, history),
            ),
            "Nodes": (self._table, lambda: node_table(stage, view, frame)),
            "Beliefs": (
                self._zoom, lambda: zoom(stage, view.theme, frame, view.pair, view.selected),
            ),
            "States": (self._states, lambda: states(stage, view, history)),
            "Log": (
                self._log,
                lambda: log(view.theme, events) + script_panel(view.theme, reversed(events)),
            ),
            "Help": (self._help, lambda: help_panel(view, frame)),
            "Selected": (self._selected, lambda: selected_panel(stage, view, past)),
        }  # fmt: skip
        if other := self._other:
            panels["Ratios"] = (
                self._ratios, lambda: ratio_table(view.theme, other, history, frame.step),
            )  # fmt: skip
        drawn = {name: self._attempt(name, make) for name, (_, make) in panels.items()}
        sample = self._attempt("Charts", lambda: sampled(stage, view, history, expectation))
        with self._window.server.atomic():
            for name, html in drawn.items():
                if html is not None:
                    self.show(name, panels[name][0], html)
            if sample is not None:
                self._attempt("Charts", lambda: self.charts.draw(sample))
                self._attempt("One state", lambda: self._state_charts.draw(sample))

    def tell_title(self, title: str) -> None:
        """Write a title on the tab of the browser."""
        words = escape(title, quote=True)
        self.show("title", self._told, f'<i class="concord-told" data-title="{words}" hidden></i>')

    def show(self, name: str, handle: Any, html: str) -> None:
        """Assign HTML to a panel unless the panel shows the same already."""
        if self._drawn.get(name) == html:
            return
        self._drawn[name] = html
        handle.content = html

    def _repaint(self, theme: Theme) -> None:
        painted = self._drawn.get("theme")
        self._drawn["theme"] = css(theme.text)
        if painted in (None, css(theme.text)):
            return
        self._window.set_theme(theme)
        self.scene.set_theme(theme)
        for charts in (self.charts, self._state_charts):
            charts.set_theme(theme)
