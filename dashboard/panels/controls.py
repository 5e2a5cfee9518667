"""The left panel: the state of the run, its pace, and the folders of widgets below."""

from collections.abc import Callable
from typing import Any

import viser

from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.source import Source, SourceState
from concord.dashboard.frames.stage import Stage
from concord.dashboard.inputs import Inputs, at_once
from concord.dashboard.panels.commands import Commands, Tell
from concord.dashboard.panels.network_controls import NetworkControls
from concord.dashboard.panels.node_controls import NodeControls
from concord.dashboard.panels.view_controls import ViewControls
from concord.dashboard.seeking.run_until import RunUntil
from concord.dashboard.theme import QUIET_BUTTON
from concord.dashboard.view import View

_FROM, _TO, _OFF = "from", "to", "off"


class LoopButtons:
    """Begin a loop at the shown step, end it there, or end the looping."""

    def __init__(self, gui: viser.GuiApi, inputs: Inputs, history: FrameHistory) -> None:
        self._inputs, self._history = inputs, history
        self.group: Any = gui.add_button_group("Loop", (_FROM, _TO, _OFF))
        self.group.on_click(at_once(lambda _: self.press(self.group.value)))

    def press(self, button: str) -> None:
        """Do what a button says."""
        self._inputs.alter(lambda view: self._take(view, button))

    def begin(self, _: Any = None) -> None:
        """Let the loop begin at the shown step."""
        self.press(_FROM)

    def end(self, _: Any = None) -> None:
        """Let the loop end at the shown step."""
        self.press(_TO)

    def _take(self, view: View, button: str) -> None:
        if button == _OFF:
            view.loop = None
        else:
            view.loop_here(button == _FROM, self._history.first_step, self._history.last_step)


_MOST_STEPS_PER_S, _MOST_SPEED = 100, 16.0
_SPEED_HINT = "1 is as fast as the plant"


class Controls:
    """The widgets of the left panel; `network` and `node` are None on a page without commands."""

    def __init__(
        self,
        gui: viser.GuiApi,
        inputs: Inputs,
        source: Source,
        view: View,
        tell: Tell,
        history: FrameHistory,
        fit: Callable[[viser.ClientHandle], None],
    ) -> None:
        self._inputs, self._source, self._history = inputs, source, history
        # A recording is played by the page; so is the run of a network that has ended.
        self._plays = not source.live
        self._answered, self._rate = True, 0.0
        self._is_paused: bool | None = None
        self._run_again: Callable[[], None] | None = None
        self.commands = Commands(source, tell)
        self.status: Any = gui.add_html("")
        self._run_folder(gui, source)
        self.network = self.node = None
        if source.takes_commands:
            self.network = NetworkControls(gui, inputs, self.commands, source.stage)
            self.node = NodeControls(gui, inputs, self.commands, source.stage)
        self.view = ViewControls(gui, inputs, source.stage, view, fit)

    def _run_folder(self, gui: viser.GuiApi, source: Source) -> None:
        with gui.add_folder("Run"):
            self.pause: Any = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
            self.one: Any = gui.add_button(
                "Step", color=QUIET_BUTTON, icon=viser.Icon.PLAYER_TRACK_NEXT
            )
            if source.live:
                hint = "0 is as fast as possible"
                self.speed: Any = gui.add_slider("Steps/s", 0, _MOST_STEPS_PER_S, 1, 0, hint=hint)
            else:
                self.speed = gui.add_slider("Speed", 0, _MOST_SPEED, 0.25, 1.0, hint=_SPEED_HINT)
            self.go_live: Any = gui.add_button(
                "Go live" if source.live else "Go to the end",
                color=QUIET_BUTTON,
                icon=viser.Icon.BROADCAST,
            )
            self.loop = LoopButtons(gui, self._inputs, self._history)
            self.loop.group.visible = not source.live
            self.until = RunUntil(gui, self._inputs, source, self.commands)
            self.again: Any = gui.add_button("Run again", icon=viser.Icon.REFRESH, visible=False)
        # On a page that is read-only the pace of the network is not for its users to choose.
        for widget in self._pace:
            widget.visible = source.takes_commands or not source.live
        self.pause.on_click(at_once(lambda event: self.toggle(event.client)))
        self.one.on_click(at_once(lambda event: self.step_once(event.client)))
        self.speed.on_update(at_once(self._set_speed))
        self.again.on_click(at_once(lambda _: self._start_again()))
        self.go_live.on_click(at_once(lambda _: self.follow()))

    @property
    def _pace(self) -> list[Any]:
        """Return the widgets for the pace of a network or of a recording."""
        return [self.pause, self.one, self.speed, *self.until.widgets]

    def toggle(self, client: Any) -> None:
        """Pause what runs, resume what is paused; a recording at its end begins again."""
        if self.until.stop():
            return
        if self._plays:
            self._inputs.alter(self._play_or_rest)
        else:
            # The press means what the button says, although other commands may wait before it.
            word = "resume" if self._is_paused else "pause"
            self.commands.soon(self.commands.send, {"do": word}, client)
            if self._is_paused:
                self.follow()

    def _play_or_rest(self, view: View) -> None:
        if view.playing:
            view.playing = False
        else:
            history = self._history
            is_read = self._source.pace().state != "LOADING"
            view.play(history.first_step, history.last_step if is_read else view.step + 1)

    def step_once(self, client: Any) -> None:
        """One step more; a network that runs is paused first."""
        if self._plays:
            self._inputs.alter(lambda view: view.look_at(view.step + 1))
        else:
            self.commands.soon(self._step_network, client)

    def _step_network(self, client: Any) -> None:
        if self.commands.is_paused() or self.commands.send({"do": "pause"}, client).accepted:
            self.commands.send({"do": "step", "count": 1}, client)
            self.follow()

    def step_back(self) -> None:
        """Show the step before, and stay there; a network that runs goes on."""
        self._inputs.alter(lambda view: view.look_at(view.step - 1))

    def follow(self) -> None:
        """Show the newest step, and what comes."""
        self._inputs.alter(lambda view: view.go_to_end())

    def offer_again(self, act: Callable[[], None]) -> None:
        """Show a button that starts the same run again by `act`; from any thread."""
        self._run_again = act
        self._inputs.show(self.again, visible=self._source.takes_commands)

    def _start_again(self) -> None:
        if self._run_again is not None:
            act, self._run_again = self._run_again, None
            self.again.disabled, self.again.label = True, "The run starts again"
            act()

    def _set_speed(self, event: Any) -> None:
        rate = float(self.speed.value)
        if self._plays:
            self._inputs.alter(lambda view: setattr(view, "speed", rate))
        else:
            command = {"do": "speed", "steps_per_second": rate}
            self.commands.newest_only("speed", command, event.client)

    def show_state(self, pace: SourceState, playing: bool) -> list[str]:
        """Let the widgets show a state of the source; return the changes that wait, in words."""
        if self._plays:
            self._show_paused(not playing)
            return []
        if pace.state == "ENDED":
            self._end(playing)
            return []
        answered = pace.state in ("RUNNING", "PAUSED")
        self._show_answered(answered)
        if answered:
            self._show_paused(pace.state == "PAUSED" and not self.until.words)
            if pace.steps_per_s != self._rate:
                self._rate = pace.steps_per_s
                self._inputs.show(self.speed, value=min(round(self._rate), _MOST_STEPS_PER_S))
        return self.commands.waiting(pace)

    def _end(self, playing: bool) -> None:
        """Turn the page of a network that has ended into one that plays what it has received."""
        self._show_answered(False)
        self._plays = True
        self._show_paused(not playing)
        for widget in self._pace:
            self._inputs.show(widget, disabled=False, visible=True)
        self._inputs.show(self.loop.group, visible=True)
        self._inputs.show(
            self.speed, label="Speed", max=_MOST_SPEED, step=0.25, value=1.0, hint=_SPEED_HINT
        )
        self._inputs.show(self.go_live, label="Go to the end")

    def _show_paused(self, paused: bool) -> None:
        """Set the button's label."""
        if paused == self._is_paused:
            return
        self._is_paused = paused
        self.pause.label = "Resume" if paused else "Pause"
        self.pause.icon = viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE

    def _show_answered(self, answered: bool) -> None:
        """Disable the widgets that command the network while it does not answer."""
        if answered == self._answered:
            return
        self._answered = answered
        widgets = self._pace
        for folder in (self.network, self.node):
            widgets += folder.widgets if folder is not None else []
        for widget in widgets:
            self._inputs.show(widget, disabled=not answered)
        # viser cannot disable a group of buttons.
        for group in self.node.groups if self.node is not None else ():
            self._inputs.show(group, visible=answered)

    def show_selected(self, node: int | None) -> None:
        """Let the dropdowns follow the selection."""
        if self.node is not None:
            self.node.show_selected(node)

    def set_stage(self, stage: Stage) -> None:
        """Show the settings and the links that the network has now."""
        if self.network is not None:
            self.network.set_stage(stage)
        if self.node is not None:
            self.node.set_stage(stage)

    def close(self) -> None:
        """Drop the commands that wait."""
        self.commands.close()
