"""The dashboard: one source, one page, and the loop that draws frames as they come.

Rates are capped whatever the network's: the scene `_SCENE_HZ`, panels of text and charts
`_PANEL_HZ`.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event as Flag

import numpy as np
import viser

from concord.dashboard.access import PageAccess
from concord.dashboard.comparison.other_run import OtherRun
from concord.dashboard.failures import PanelFailures
from concord.dashboard.frames.expected import Expectation
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.source import Source, SourceState
from concord.dashboard.frames.stage import PlantDrawing, Stage
from concord.dashboard.frames.verdict import STEPS, RunVerdict, verdict
from concord.dashboard.inputs import Inputs
from concord.dashboard.panels.controls import Controls
from concord.dashboard.panels.export_buttons import ExportButtons, Shown
from concord.dashboard.panels.page import Page
from concord.dashboard.panels.table import status
from concord.dashboard.player import Extent, play_live, play_recorded
from concord.dashboard.scene.magnification import followed_magnification
from concord.dashboard.theme import DARK, LIGHT, Theme
from concord.dashboard.touch.hand import Hand
from concord.dashboard.view import MANY_NODES, View
from concord.dashboard.window import PageServer

_SCENE_HZ, _PANEL_HZ = 10.0, 4.0


class Dashboard:
    """One page on one source."""

    def __init__(
        self, source: Source, host: str, port: int, theme: Theme, folder: Path | None,
        expected: Expectation, other: OtherRun | None = None,
    ) -> None:  # fmt: skip
        self._other = other
        self._expected = expected
        self.source, self.stage = source, source.stage
        self.view = first_view(self.stage, theme, source.live)
        self.history = FrameHistory(self.stage)
        self._changed = Flag()
        self._name = self.stage.setup.scenario.name if folder is None else folder.name
        self._next_scene_s = self._next_panel_s = self._last_s = 0.0
        self._stale = True
        self._window = PageServer(host, port)
        self.inputs = Inputs(self.server.get_event_loop(), self._changed.set)
        self._window.set_theme(theme)
        gui = self.server.gui
        self.controls = Controls(
            gui, self.inputs, source, self.view, self._window.tell, self.history, self._window.fit
        )
        ExportButtons(gui, self._shown, folder, self._window.free)
        self.failures = PanelFailures()
        self.page = Page(
            self._window, self.inputs, self.stage, self.view, self.failures, self.history, other
        )
        self._hand = None
        if source.takes_commands:
            self._hand = Hand(self.server, self.page.scene, self.controls.commands)
        self._shortcuts()

    @property
    def server(self) -> viser.ViserServer:
        """Return the server of the page."""
        return self._window.server

    @property
    def url(self) -> str:
        """Return the address of the page, with the token that lets a browser in."""
        return self._window.url

    @property
    def access(self) -> PageAccess:
        """Return the rules of access to the page."""
        return self._window.access

    def _shown(self) -> Shown:
        with self.view.lock:
            history = self.history
            stage = history.at(self.view.step).stage if len(history) else self.stage
            return Shown(stage, replace(self.view), history, self.page.charts.drawn)

    def _shortcuts(self) -> None:
        bind, controls = self._window.bind, self.controls
        bind("Pause or resume", "P", controls.toggle)
        bind("One step", "N", controls.step_once)
        bind("One step back", "B", lambda _: controls.step_back())
        bind("Loop from here", "I", controls.loop.begin)
        bind("Loop to here", "O", controls.loop.end)
        bind("Go to the newest step", "G", lambda _: controls.follow())
        bind("Select the next node", "J", lambda _: self._select_next(1))
        bind("Select the node before", "K", lambda _: self._select_next(-1))
        bind("Select no node", "X", lambda _: self.inputs.select(None))
        bind("Present: large letters, no controls", "F", self._window.present)
        bind("Restore the layout", "L", self._window.restore)
        bind("Dark or light", "D", lambda _: self._toggle_theme())

    def _select_next(self, by: int) -> None:
        def select(view: View) -> None:
            first = 0 if by > 0 else self.stage.nodes - 1
            now = view.selected
            view.selected = first if now is None else (now + by) % self.stage.nodes

        self.inputs.alter(select)

    def _toggle_theme(self) -> None:
        def toggle(view: View) -> None:
            view.theme = LIGHT if view.theme.dark else DARK
            self.inputs.show(self.controls.view.dark, value=view.theme.dark)

        self.inputs.alter(toggle)

    def run(self, until: Callable[[], bool]) -> None:
        """Draw until `until()` holds; without a client, only keep the frames that come."""
        while not until():
            if self.server.get_clients():
                self.tick(time.monotonic())
            else:
                self.history_add()
                self._stale = True
                self._changed.clear()
            # Pacing lets the server's thread send; a change is drawn at once.
            self._changed.wait(0.5 / _SCENE_HZ)

    def tick(self, now_s: float) -> None:
        """Take the frames that have come, and draw what is due on a clock that never goes back."""
        self.history_add()
        elapsed_s = min(now_s - self._last_s, 0.5) if self._last_s else 0.0
        self._last_s = now_s
        with self.view.lock:
            # The flag is cleared first: a change from now on belongs to the next turn.
            self._stale |= self._changed.is_set()
            self._changed.clear()
            self.failures.attempt("The page", lambda: self._draw(now_s, elapsed_s))

    def _draw(self, now_s: float, elapsed_s: float) -> None:
        """Draw what is due; the view's lock is held."""
        self.inputs.apply(self.view)
        if not len(self.history):
            self._draw_status(None)
            return
        self._stale |= self._advance(elapsed_s)
        panels_due = now_s >= self._next_panel_s
        if panels_due and not self._stale:
            # Also of a network from which nothing comes: the page says for how long.
            self._next_panel_s = now_s + 1 / _PANEL_HZ
            self._draw_status(self.history.at(self.view.step))
        elif self._stale and now_s >= self._next_scene_s:
            self._next_scene_s = now_s + 1 / _SCENE_HZ
            self._stale = not panels_due
            self._magnify(self.history.at(self.view.step))
            self.page.draw_scene(self.view, self.history)
            self._window.keep_in_sight(self.page.scene.target)
            self._window.follow(self.page.scene.target if self.view.follow_target else None)
            if panels_due:
                self._next_panel_s = now_s + 1 / _PANEL_HZ
                self.controls.show_selected(self.view.selected)
                self.page.draw_panels(self.view, self.history, self._expected)
                self._draw_status(self.history.at(self.view.step))

    def _magnify(self, frame: StepFrame) -> None:
        if self.view.is_automatic and self.stage.picture is PlantDrawing.PLANE:
            now = self.view.magnify
            self.view.magnify = followed_magnification(now, frame, self.stage.scale)

    def history_add(self) -> None:
        """Take the frames that have come."""
        poll = self.source.poll
        # A recording that cannot be read ends its page; a network may send better steps later.
        frames = (self.failures.attempt("A step", poll) or []) if self.source.live else poll()
        if frames and not len(self.history):
            self.view.step = frames[0].step
        self.history.add(frames)
        if self._other is not None:
            self._other.poll()
        if self.source.stage is not self.stage:
            self.stage = self.source.stage
            self.controls.set_stage(self.stage)
        if frames:
            self.page.set_extent(self.history.first_step, self.history.last_step)
            self._changed.set()
        self.failures.attempt("Until", lambda: self.controls.until.advance(self.history))

    def _advance(self, elapsed_s: float) -> bool:
        """Move the shown step and the cursor on; True where something moved."""
        view, history, pace = self.view, self.history, self.source.pace()
        rounds = max(1, len(history.at(view.step).cycles))
        extent = Extent(history.first_step, history.last_step, rounds, pace.state == "LOADING")
        if self.source.live and pace.state != "ENDED":
            return play_live(view, extent, elapsed_s, pace.state == "PAUSED")
        return play_recorded(view, extent, elapsed_s, self.stage.setup.time_step_s)

    def _draw_status(self, frame: StepFrame | None) -> None:
        pace = self.source.pace()
        state, detail, until = pace.state, pace.detail, self.controls.until.words
        if until:
            detail = f"{detail}; until {until}"
            state = "RUNNING" if state == "PAUSED" else state
        if state == "RECORDED":
            state = f"RECORDED {self._name}"
        mode = mode_of(self.view, pace, self.history, self.source.live)
        waiting = self.controls.show_state(pace, self.view.playing)
        if (hand := self._hand) is not None:
            pending = self.controls.commands.pending(pace)
            self.failures.attempt("Ghosts", lambda: hand.draw(self.view.theme, pending))
        judged = None if frame is None else self.failures.attempt("Verdict", self._judge)
        # A factor after the word has no room beside viser's buttons.
        self._window.label("concord" if judged is None else judged.word.partition(" ")[0])
        failures = self.failures.sentences()
        html = status(
            self.stage, self.view.theme, frame, state, detail, failures, waiting, judged, mode
        )
        self.page.show("status", self.controls.status, html)
        if frame is not None:
            self.page.tell_title(f"{self._name}, step {frame.step}")

    def _judge(self) -> RunVerdict:
        frames = self.history.until(self.view.step, STEPS)
        return verdict(frames, self._expected(np.array([frame.time_s for frame in frames])))

    def close(self) -> None:
        """End the page."""
        self.controls.close()
        self.source.close()
        self.server.stop()


def mode_of(view: View, pace: SourceState, history: FrameHistory, live: bool) -> str:
    """Return how the shown step moves: paused, playing, following, or where it stands beside a
    network that goes on."""
    newest = history.last_step
    if live and pace.state != "ENDED":
        if not view.follow:
            return f"showing {view.step}, live is {newest}"
        return "following" if pace.state == "RUNNING" else ""
    if view.playing:
        return "playing"
    if view.follow and pace.state == "LOADING":
        return "following"
    return "paused"


def first_view(stage: Stage, theme: Theme, live: bool) -> View:
    """Return the view with which a page on a network begins."""
    few = stage.nodes <= MANY_NODES
    states = len(stage.state_names)
    return View(
        theme=theme,
        playing=not live,
        ellipses="all" if few else "selected",
        sight_lines=few,
        pair=(stage.place[0], stage.place[1]) if stage.place else (0, min(1, states - 1)),
        state=stage.score.states[0],
    )
