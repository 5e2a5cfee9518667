"""Commands from the page: asked of the source one after the other, answered in a corner."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from concord.dashboard.frames.source import CommandAnswer, Source, SourceState
from concord.dashboard.panels.command_words import in_a_sentence

Tell = Callable[[Any, str, str, bool], None]
"""(client, title, body, is trouble): show a short message to a person."""


class Commands:
    """A queue of commands with a thread of its own; a recording has no network to command."""

    def __init__(self, source: Source, tell: Tell) -> None:
        self._source, self.tell = source, tell
        self._thread = ThreadPoolExecutor(1, "commands")
        self._newest: dict[str, dict[str, Any]] = {}
        # Accepted while the network was paused: at how many completed steps, words and command.
        self._waiting: list[tuple[int, str, dict[str, Any]]] = []

    def soon(self, act: Callable[..., object], *values: Any) -> None:
        """Call `act(*values)` in the thread of the commands."""
        self._thread.submit(act, *values).add_done_callback(_raise)

    def newest_only(self, what: str, command: dict[str, Any], client: Any) -> None:
        """Send the last of the commands that a slider makes on its way."""
        self._newest[what] = command

        def ask() -> None:
            if newest := self._newest.pop(what, None):
                self.send(newest, client)

        self.soon(ask)

    def send(self, command: dict[str, Any], client: Any) -> CommandAnswer:
        """Ask the source, and tell the person how it answered; this call waits for the answer."""
        before = self._source.pace()
        answer = self._source.ask(command)
        what = in_a_sentence(command, self._source.stage.names)
        if not answer.accepted:
            self.tell(client, "Refused", answer.detail or what, True)
        elif command["do"] not in ("pause", "resume", "step", "speed"):
            paused = before.state == "PAUSED"
            when = "It holds from the next step, which waits for Step or Resume." if paused else ""
            self.tell(client, "Accepted", f"{what[0].upper()}{what[1:]}. {when}", False)
            if paused:
                self._waiting = [*self._waiting, (before.completed, what, command)]
        return answer

    def waiting(self, pace: SourceState) -> list[str]:
        """Return the changes that hold from the next step of a paused network, in words."""
        if pace.state == "SILENT":
            return []
        self._waiting = [one for one in self._waiting if one[0] == pace.completed]
        return [what for _, what, _ in self._waiting]

    @property
    def pending(self) -> list[dict[str, Any]]:
        """Return the commands of which `waiting` told last."""
        return [command for *_, command in self._waiting]

    def is_paused(self) -> bool:
        """Say whether the network is paused."""
        return self._source.pace().state == "PAUSED"

    def close(self) -> None:
        """Drop the commands that wait."""
        self._thread.shutdown(wait=False, cancel_futures=True)


def _raise(done: "Future[object]") -> None:
    """Raise an error of the thread, which no caller waits for."""
    if not done.cancelled():
        done.result()
