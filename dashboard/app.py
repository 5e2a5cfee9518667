"""The page: one server, its panels, and the loop that draws what there is to draw.

Rates are capped whatever the network's: the scene `_SCENE_HZ`, panels of text and charts
`_PANEL_HZ`. Everything is worked out before `atomic()`, inside which properties are only assigned.
"""

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event as Flag
from typing import Any

import numpy as np
import rich
import viser

from dashboard.bridge import Bridge
from dashboard.camera import FIELD_OF_VIEW_RAD, Free, aimed
from dashboard.charts import Charts, StateChart
from dashboard.conditions import sender_at
from dashboard.controls import MAGNIFIED, Controls
from dashboard.expected import Expectation
from dashboard.export_buttons import ExportButtons
from dashboard.frame import BusCycle, Frame
from dashboard.history import History
from dashboard.inputs import Inputs, at_once
from dashboard.layout import lay_out
from dashboard.player import Extent, play_live, play_recorded
from dashboard.scene import Scene
from dashboard.scene_plants import TRAIL
from dashboard.selected import selected_panel
from dashboard.source import Answer, Source
from dashboard.stage import SCENE_WIDTH, Picture
from dashboard.states import states
from dashboard.table import log, node_table, status
from dashboard.theme import DARK, LIGHT, Theme, css
from dashboard.timeline import RASTER_ROWS, TimelineView
from dashboard.view import MANY_NODES, View
from dashboard.zoom import zoom

_SCENE_HZ, _PANEL_HZ = 10.0, 4.0
_CHART_HEIGHT = 78
_CAR_TRAIL = 3000
_SETTLED_FRAMES = 20


class Dashboard:
    """One page on one source."""

    def __init__(
        self, source: Source, host: str, port: int, theme: Theme, folder: Path | None,
        expected: Expectation,
    ) -> None:  # fmt: skip
        self._source, self._folder, self._expected = source, folder, expected
        self._stage = source.stage
        self.view = View(theme=theme)
        self._choose_view()
        self.history = History(self._stage)
        # The only line that this process says is ours.
        rich.get_console().quiet = True
        self._server = viser.ViserServer(host=host, port=port, verbose=False)
        self._changed = Flag()
        self.inputs = Inputs(self._server.get_event_loop(), self._changed.set)
        self._ended = Flag()
        self._next_scene_s = self._next_panel_s = self._last_s = 0.0
        self._stale = True
        self._drawn: dict[str, str] = {}
        self._build()

    @property
    def port(self) -> int:
        """Where the page is."""
        return self._server.get_port()

    @property
    def source(self) -> Source:
        """Where its frames come from."""
        return self._source

    @property
    def server(self) -> viser.ViserServer:
        """The server of the page, for those who look at it from outside."""
        return self._server

    def _choose_view(self) -> None:
        stage, view = self._stage, self.view
        states = len(stage.state_names)
        view.pair = (stage.place[0], stage.place[1]) if stage.place else (0, min(1, states - 1))
        view.state = stage.score.states[0]
        view.ellipses = "all" if stage.nodes <= MANY_NODES else "selected"
        view.sight_lines = stage.nodes <= MANY_NODES
        view.playing = not self._source.live

    # --- building -----------------------------------------------------------------------------

    def _build(self) -> None:
        server, stage, view = self._server, self._stage, self.view
        gui = server.gui
        self._set_theme(view.theme)
        gui.set_panel_label("concord")
        self.controls = Controls(gui, self.inputs, self._source, view, self._tell)
        self.exports = ExportButtons(gui, self, self._folder)
        panels = lay_out(server, stage.picture is not Picture.PLANE)
        with panels.charts:
            self.charts = Charts(gui, stage, view.theme, _CHART_HEIGHT)
        with panels.state:
            self._state_chart = StateChart(gui, stage, view.theme, 190)
        with panels.log:
            self._log: Any = gui.add_html("")
        with panels.nodes:
            self._table = Bridge(gui, stage.nodes, self.pick, self.point)
        with panels.selected:
            self._selected: Any = gui.add_html("")
        with panels.bus:
            self._bus = Bridge(gui, stage.nodes, self.pick, self.point)
            self.slider: Any = gui.add_slider("Step", 0, 1, 1, 0)
        with panels.zoom:
            self._zoom = Bridge(gui, stage.nodes, self.pick, self.point)
        with panels.states:
            self._states: Any = gui.add_html("")
        self.slider.on_update(at_once(self._scrub))
        self._timeline = TimelineView(stage)
        self.scene = Scene(server.scene, stage, view.theme, self.pick)
        self._aim(panels.arrange(1600, 900))
        server.on_client_connect(self._fit(panels.arrange))
        self._shortcuts()

    def _fit(self, arrange: Callable[[int, int], Free]) -> Callable[[viser.ClientHandle], None]:
        """The panels fit the window of whoever came last, and the scene what they leave."""

        def fit(client: viser.ClientHandle) -> None:
            camera = client.camera
            with contextlib.suppress(AssertionError):
                if camera.image_width and camera.image_height:
                    free = arrange(camera.image_width, camera.image_height)
                    camera.position, camera.look_at = aimed(self.scene.extent(), free)

        return fit

    def _set_theme(self, theme: Theme) -> None:
        self._server.gui.configure_theme(
            dark_mode=theme.dark,
            show_logo=False,
            show_share_button=False,
            brand_color=(0, 114, 178),
        )

    def _aim(self, free: Free) -> None:
        """What whoever comes sees first."""
        camera = self._server.initial_camera
        camera.position, camera.look_at = aimed(self.scene.extent(), free)
        camera.fov = FIELD_OF_VIEW_RAD

    def _shortcuts(self) -> None:
        def bind(label: str, key: Any, act: Callable[[Any], None]) -> None:
            command = self._server.gui.add_command(label, hotkey=key)
            command.on_trigger(at_once(act))

        bind("Pause or resume", "P", lambda event: self.controls.toggle(event.client))
        bind("One step", "N", lambda event: self.controls.step_once(event.client))
        bind("Go to the newest step", "G", lambda _: self.controls.follow())
        bind("Select the next node", "J", lambda _: self._select_next(1))
        bind("Select the node before", "K", lambda _: self._select_next(-1))
        bind("Select no node", "X", lambda _: self.pick(None))
        bind("Dark or light", "D", lambda _: self._toggle_theme())

    # --- what people do -----------------------------------------------------------------------

    def pick(self, node: int | None) -> None:
        """Select a node, everywhere."""
        self.inputs.alter(lambda view: setattr(view, "selected", node))

    def point(self, node: int | None) -> None:
        """The pointer rests on a node, or on none."""
        self.inputs.alter(lambda view: setattr(view, "hovered", node))

    def _select_next(self, by: int) -> None:
        def select(view: View) -> None:
            first = 0 if by > 0 else self._stage.nodes - 1
            now = view.selected
            view.selected = first if now is None else (now + by) % self._stage.nodes

        self.inputs.alter(select)

    def _toggle_theme(self) -> None:
        def toggle(view: View) -> None:
            view.theme = LIGHT if view.theme.dark else DARK
            self.inputs.show(self.controls.dark, value=view.theme.dark)

        self.inputs.alter(toggle)

    def _scrub(self, _: Any) -> None:
        step = int(self.slider.value)
        self.inputs.alter(lambda view: view.look_at(step))

    def _tell(self, client: Any, title: str, body: str, is_trouble: bool) -> None:
        """A short message in the corner, for whoever did something or, failing that, for all."""
        clients = [client] if client is not None else list(self._server.get_clients().values())
        for one in clients:
            one.add_notification(
                title, body, auto_close_seconds=8.0 if is_trouble else 3.0,
                color="red" if is_trouble else "green",
            )  # fmt: skip

    # --- drawing ------------------------------------------------------------------------------

    def run(self, until: Callable[[], bool]) -> None:
        """Draw until `until` says so; while nobody looks, only keep what there will be to see."""
        while not until():
            if self._server.get_clients():
                self.tick(time.monotonic())
            else:
                self.history_add()
                self._stale = True
                self._changed.clear()
            # Pacing lets the server's thread send; a change is drawn at once.
            self._changed.wait(0.5 / _SCENE_HZ)

    def tick(self, now_s: float) -> None:
        """Take what has come, and draw what is due at this time of a clock that never goes back."""
        self.history_add()
        elapsed_s = min(now_s - self._last_s, 0.5) if self._last_s else 0.0
        self._last_s = now_s
        with self.view.lock:
            # Cleared before: what comes from now on is for the next turn.
            self._stale |= self._changed.is_set()
            self._changed.clear()
            self.inputs.apply(self.view)
            if not len(self.history):
                self._show("status", self.controls.status, self._status(None))
                return
            self._stale |= self._advance(elapsed_s)
            if self._stale and now_s >= self._next_scene_s:
                self._next_scene_s = now_s + 1 / _SCENE_HZ
                self._draw_scene()
                panels_due = now_s >= self._next_panel_s
                if panels_due:
                    self._next_panel_s = now_s + 1 / _PANEL_HZ
                    self._draw_panels()
                self._stale = not panels_due

    def history_add(self) -> None:
        """Take the frames that have come."""
        frames = self._source.poll()
        if frames and not len(self.history):
            self.view.step = frames[0].step
        before = len(self.history)
        self.history.add(frames)
        # The prior is wide; what errors are like is known a little later.
        if before < _SETTLED_FRAMES <= len(self.history):
            self._magnify(frames[-1])
        if self._source.stage is not self._stage:
            self._stage = self._source.stage
            self._timeline = TimelineView(self._stage)
            self.controls.set_stage(self._stage)
        if frames:
            first, last = self.history.first_step, max(1, self.history.last_step)
            self.inputs.show(self.slider, max=last, min=first)
            self._changed.set()

    def _magnify(self, frame: Frame) -> None:
        if self._stage.picture is Picture.PLANE:
            self.view.magnify = _magnification(frame, self._stage.scale)
            self.inputs.show(self.controls.magnify, value=f"{self.view.magnify:g}")

    def _advance(self, elapsed_s: float) -> bool:
        """Move the shown step and the cursor on; True where something moved."""
        view, history, pace = self.view, self.history, self._source.pace()
        rounds = max(1, len(history.at(view.step).cycles))
        extent = Extent(history.first_step, history.last_step, rounds, pace.state == "LOADING")
        if self._source.live:
            return play_live(view, extent, elapsed_s, pace.state == "PAUSED")
        return play_recorded(view, extent, elapsed_s, self._stage.setup.time_step_s)

    def _shown(self) -> tuple[Frame, BusCycle, float, int]:
        """The frame, its cycle at the cursor, the time in that, and who sends."""
        frame = self.history.at(self.view.step)
        number = min(int(self.view.cursor), len(frame.cycles) - 1)
        sender, now_us = sender_at(frame, self.view.cursor)
        return frame, frame.cycles[number], now_us, sender

    def _draw_scene(self) -> None:
        view = self.view
        frame, cycle, now_us, sender = self._shown()
        trail = _CAR_TRAIL if self._stage.picture is Picture.TRACK else TRAIL
        past = self.history.until(frame.step, trail)
        assign = self.scene.draw(view, frame, past, sender)
        timeline = self._timeline.draw(
            view.theme, frame, self._past_cycles(cycle), cycle, now_us, view.selected
        )
        with self._server.atomic():
            assign()
            self._show("bus", self._bus, timeline)
        self.inputs.show(self.slider, value=frame.step)

    def _past_cycles(self, shown: BusCycle) -> list[BusCycle]:
        """Cycles before the shown one, the newest first."""
        wanted = -(-RASTER_ROWS // max(1, len(self.history.at(self.view.step).cycles))) + 1
        frames = self.history.until(self.view.step, wanted)
        cycles = [cycle for frame in frames for cycle in frame.cycles]
        return [cycle for cycle in reversed(cycles) if cycle.cycle < shown.cycle][:RASTER_ROWS]

    def _draw_panels(self) -> None:
        view, stage = self.view, self._stage
        frame = self.history.at(view.step)
        rows = node_table(stage, view, frame)
        picture = zoom(stage, view.theme, frame, view.pair, view.selected)
        events = [event for event in reversed(self.history.log) if event.step <= view.step]
        about = selected_panel(stage, view, frame)
        over_time = states(stage, view, self.history)
        state = self._status(frame)
        self.controls.show_selected(view.selected)
        with self._server.atomic():
            self._show("table", self._table, rows)
            self._show("zoom", self._zoom, picture)
            self._show("states", self._states, over_time)
            self._show("log", self._log, log(view.theme, events))
            self._show("selected", self._selected, about)
            self._show("status", self.controls.status, state)
            self.charts.draw(view, self.history, self._expected)
            self._state_chart.draw(view, self.history)
        self._repaint()

    def _status(self, frame: Frame | None) -> str:
        pace = self._source.pace()
        state = pace.state
        if not self._source.live:
            state = "RUNNING" if self.view.playing else "PAUSED"
            self.controls.show_paused(not self.view.playing)
        else:
            self.controls.show_paused(state == "PAUSED")
        return status(self._stage, self.view.theme, frame, state, pace.detail)

    def _show(self, name: str, handle: Any, html: str) -> None:
        """Assign HTML; what is equal to what is shown is not sent again."""
        if self._drawn.get(name) == html:
            return
        self._drawn[name] = html
        handle.content = html

    def _repaint(self) -> None:
        theme = self.view.theme
        if self._drawn.get("theme") == css(theme.text):
            return
        first = "theme" not in self._drawn
        self._drawn["theme"] = css(theme.text)
        if not first:
            self._set_theme(theme)
            self.scene.set_theme(theme)
            self.charts.set_theme(theme)

    def snapshot(self) -> View:
        """The view as it is now, for an export that takes its time."""
        with self.view.lock:
            return replace(self.view)

    @property
    def stage(self):
        """The stage that is drawn."""
        return self._stage

    def ask(self, command: dict[str, Any]) -> Answer:
        """Command the network."""
        return self._source.ask(command)

    def close(self) -> None:
        """End the page."""
        self.controls.close()
        self._source.close()
        self._server.stop()


def _magnification(frame: Frame, scale: float) -> float:
    """How much errors must be enlarged to be seen: three deviations make a seventh of the map."""
    width = frame.scores.width[np.isfinite(frame.scores.width)]
    if not len(width):
        return 1.0
    drawn = 3.0 * float(np.median(width)) * scale
    wanted = SCENE_WIDTH / 7 / max(drawn, 1e-9)
    return float(max((m for m in MAGNIFIED if m <= wanted), default=1))
