"""The left panel: the state of the run, its pace, and the folders of widgets below."""

from typing import Any

import viser

from concord.dashboard.frames.source import Source
from concord.dashboard.frames.stage import Stage
from concord.dashboard.inputs import Inputs, at_once
from concord.dashboard.panels.commands import Commands, Tell
from concord.dashboard.panels.network_controls import NetworkControls
from concord.dashboard.panels.node_controls import NodeControls
from concord.dashboard.panels.view_controls import ViewControls
from concord.dashboard.theme import QUIET_BUTTON
from concord.dashboard.view import View


class Controls:
    """The widgets of the left panel; `network` and `node` are None on a page without commands."""

    def __init__(
        self, gui: viser.GuiApi, inputs: Inputs, source: Source, view: View, tell: Tell
    ) -> None:
        self._inputs, self._live = inputs, source.live
        self._answered = True
        self._commands = Commands(source, tell)
        self.status: Any = gui.add_html("")
        self._run_folder(gui, source)
        self.network = self.node = None
        if source.takes_commands:
            self.network = NetworkControls(gui, inputs, self._commands, source.stage)
            self.node = NodeControls(gui, inputs, self._commands, source.stage)
        self.view = ViewControls(gui, inputs, source.stage, view)

    def _run_folder(self, gui: viser.GuiApi, source: Source) -> None:
        with gui.add_folder("Run"):
            self.pause: Any = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
            self.one: Any = gui.add_button(
                "Step", color=QUIET_BUTTON, icon=viser.Icon.PLAYER_TRACK_NEXT
            )
            top = 100 if self._live else 16
            self.speed: Any = gui.add_slider(
                "Steps/s" if self._live else "Speed", 0, top, 1 if self._live else 0.25,
                0 if self._live else 1.0,
                hint="0 is as fast as possible" if self._live else "1 is as fast as the plant",
            )  # fmt: skip
            self.go_live: Any = gui.add_button(
                "Go live" if self._live else "Go to the end",
                color=QUIET_BUTTON,
                icon=viser.Icon.BROADCAST,
            )
        # On a page that is read-only the pace of the network is not for its users to choose.
        for widget in (self.pause, self.one, self.speed):
            widget.visible = source.takes_commands or not source.live
        self.pause.on_click(at_once(lambda event: self.toggle(event.client)))
        self.one.on_click(at_once(lambda event: self.step_once(event.client)))
        self.speed.on_update(at_once(self._set_speed))
        self.go_live.on_click(at_once(lambda _: self.follow()))

    def toggle(self, client: Any) -> None:
        """Pause what runs, resume what is paused."""
        if self._live:
            self._commands.soon(self._toggle_network, client)
        else:
            self._inputs.alter(lambda view: setattr(view, "playing", not view.playing))

    def _toggle_network(self, client: Any) -> None:
        self._commands.send({"do": "resume" if self._commands.is_paused() else "pause"}, client)

    def step_once(self, client: Any) -> None:
        """One step more; a network that runs is paused first."""
        if self._live:
            self._commands.soon(self._step_network, client)
        else:
            self._inputs.alter(lambda view: view.look_at(view.step + 1))

    def _step_network(self, client: Any) -> None:
        if self._commands.is_paused() or self._commands.send({"do": "pause"}, client).accepted:
            self._commands.send({"do": "step", "count": 1}, client)
            self.follow()

    def follow(self) -> None:
        """Show the newest step, and what comes."""
        self._inputs.alter(lambda view: setattr(view, "follow", True))

    def _set_speed(self, event: Any) -> None:
        rate = float(self.speed.value)
        if self._live:
            command = {"do": "speed", "steps_per_second": rate}
            self._commands.newest_only("speed", command, event.client)
        else:
            self._inputs.alter(lambda view: setattr(view, "speed", rate))

    def show_paused(self, paused: bool) -> None:
        """Set the button's label."""
        self.pause.label = "Resume" if paused else "Pause"
        self.pause.icon = viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE

    def show_answered(self, answered: bool) -> None:
        """Disable the widgets that command the network while it does not answer."""
        if not self._live or answered == self._answered:
            return
        self._answered = answered
        widgets = [self.pause, self.one, self.speed]
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
        """Show the settings that the network has now."""
        if self.network is not None:
            self.network.set_stage(stage)

    def close(self) -> None:
        """Drop the commands that wait."""
        self._commands.close()
