"""Commands from the page: asked of the source one after the other, answered in a corner."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import msgspec

from concord.dashboard.frames.source import CommandAnswer, Source, SourceState
from concord.dashboard.panels.command_words import in_a_sentence
from concord.dashboard.touch.script import script_of
from concord.nodes.commands import in_words

Tell = Callable[[Any, str, str, bool], None]
"""(client, title, body, is trouble): show a short message to a person."""


class Commands:
    """A queue of commands with a thread of its own; a recording has no network to command."""

    def __init__(self, source: Source, tell: Tell) -> None:
        self._source, self.tell = source, tell
        self._thread = ThreadPoolExecutor(1, "commands")
        self._newest: dict[str, dict[str, Any]] = {}

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
        return answer

    def waiting(self, pace: SourceState) -> list[str]:
        """Return the changes that hold from the next step of a paused network, in words."""
        return [in_a_sentence(one, self._source.stage.names) for one in self.pending(pace)]

    def pending(self, pace: SourceState) -> list[dict[str, Any]]:
        """Return these changes as commands."""
        lines = [line.split()[1:] for line in script_of(pace.pending)]
        return [msgspec.to_builtins(in_words(words)) for words in lines]

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
