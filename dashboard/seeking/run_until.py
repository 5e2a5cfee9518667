"""Runs a network, or seeks in a recording, until a condition holds.

The page steps a network: it asks for the next step when it has judged the last one. So the network
stands at the step at which the condition holds, and takes changes there.
"""

from itertools import islice
from typing import Any

import viser

from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.source import Source, SourceState
from concord.dashboard.inputs import Inputs, at_once
from concord.dashboard.panels.commands import Commands
from concord.dashboard.seeking.breakpoint import QUANTITIES, Breakpoint, read_breakpoint
from concord.dashboard.theme import QUIET_BUTTON
from concord.dashboard.view import View

_HINT = "nees > 10, error 3 > 5, silent 2, missed and rmse > 1; quantities: " + ", ".join(
    QUANTITIES
)
_START, _STOP = "Run until", "Stop looking"
# A picture must not wait for a whole recording.
_FRAMES_PER_TURN = 1000


class RunUntil:
    """A field for a condition and a button; `words` is the condition looked for, else empty."""

    def __init__(
        self, gui: viser.GuiApi, inputs: Inputs, source: Source, commands: Commands
    ) -> None:
        self._inputs, self._source, self._commands = inputs, source, commands
        self._wanted: Breakpoint | None = None
        self._judged = self._asked = -1
        self.condition: Any = gui.add_text("Until", "", hint=_HINT)
        self.button: Any = gui.add_button(_START, color=QUIET_BUTTON, icon=viser.Icon.FLAG)
        self.button.on_click(at_once(lambda _: self._press()))

    @property
    def widgets(self) -> list[Any]:
        """Return the widgets, which command a network."""
        return [self.condition, self.button]

    @property
    def words(self) -> str:
        """Return the condition that is looked for; empty where none is."""
        return "" if self._wanted is None else self._wanted.words

    def stop(self) -> bool:
        """Look no further; return whether the page was looking. A network stays paused."""
        was, self._wanted = self._wanted, None
        if was is not None:
            self._inputs.show(self.button, label=_START)
        return was is not None

    def _press(self) -> None:
        if self.stop():
            return
        try:
            wanted = read_breakpoint(self.condition.value, self._source.stage)
        except ValueError as error:
            self._commands.tell(None, "Refused", str(error), True)
            return
        self._inputs.alter(lambda view: self._begin(wanted, view))

    def _begin(self, wanted: Breakpoint, view: View) -> None:
        """Look at the steps after the shown one; of a network at those that come."""
        self._judged, self._asked = view.step, -1
        if self._is_running():
            self._judged = self._source.pace().completed - 1
            self._commands.soon(self._pause)
        self._wanted = wanted
        self.button.label = _STOP

    def _is_running(self) -> bool:
        """Say whether there is a network that can be stepped."""
        return self._source.takes_commands and self._source.pace().state != "ENDED"

    def _pause(self) -> None:
        if not self._commands.is_paused():
            self._send({"do": "pause"})

    def _send(self, command: dict[str, Any]) -> None:
        if not self._commands.send(command, None).accepted:
            self.stop()

    def advance(self, history: FrameHistory) -> None:
        """Judge the frames that have come. Runs on: the loop that draws."""
        wanted = self._wanted
        if wanted is None:
            return
        for frame in islice(history.after(self._judged), _FRAMES_PER_TURN):
            self._judged = frame.step
            if wanted.holds(frame):
                self._reach(wanted, frame.step, history.last_step)
                return
        if self._judged >= history.last_step:
            self._go_on(wanted, history, self._source.pace())

    def _reach(self, wanted: Breakpoint, step: int, newest: int) -> None:
        """Show the step that was found; the page goes on to follow a network that stands there."""
        self.stop()
        if self._is_running() and step == newest:
            self._inputs.alter(lambda view: view.go_to_end())
        else:
            self._inputs.alter(lambda view: view.look_at(step))
        self._commands.tell(None, "Found", f"{wanted.words} holds after step {step}.", False)

    def _go_on(self, wanted: Breakpoint, history: FrameHistory, pace: SourceState) -> None:
        """Ask for the next step, or say that there is none."""
        if pace.state in ("ENDED", "RECORDED"):
            self.stop()
            words = f"{wanted.words} holds in no step up to {history.last_step}."
            self._commands.tell(None, "Not found", words, True)
            return
        # Otherwise the frame of the step before is still on its way.
        is_seen = pace.completed <= history.last_step + 1 or not len(history)
        if pace.state == "PAUSED" and pace.completed >= self._asked and is_seen:
            self._asked = pace.completed + 1
            self._commands.soon(self._send, {"do": "step", "count": 1})
