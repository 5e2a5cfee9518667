"""Buttons for the two ends of a loop, between which a recording plays again and again."""

from typing import Any

import viser

from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.inputs import Inputs, at_once
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
