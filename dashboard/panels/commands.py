"""Commands from the page: asked of the source one after the other, answered in a corner."""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import msgspec

from concord.dashboard.frames.network import value_in_words
from concord.dashboard.frames.source import CommandAnswer, Source, SourceState
from concord.dashboard.touch.script import script_of
from concord.nodes.commands import in_words
from concord.nodes.faults.vocabulary import CHANNELS, EVERY_FAULT


def in_a_sentence(command: Mapping[str, Any], names: tuple[str, ...]) -> str:
    """Return a command of docs/control.md in words, without a full stop."""
    return _WORDS[command["do"]](command, names)


def _link(command: Mapping[str, Any], names: tuple[str, ...]) -> str:
    """Return the link of a command; every link where it names none."""
    if command.get("sender") is None:
        return "every link"
    ends = f"{names[command['sender']]} and {names[command['receiver']]}"
    if command.get("both", True):
        return f"the link between {ends}"
    return f"the link from {ends.replace(' and ', ' to ')}"


def _fault(command: Mapping[str, Any], names: tuple[str, ...]) -> str:
    kind = command["kind"]
    known = CHANNELS if EVERY_FAULT[kind].place == "channel" else names
    nodes = [known[node] for node in command.get("nodes", ())]
    return " ".join((f"fault {kind}", *nodes, *(f"{n:g}" for n in command.get("numbers", ()))))


def _speed(command: Mapping[str, Any], _: tuple[str, ...]) -> str:
    rate = command["steps_per_second"]
    return f"at most {rate:g} steps per second" if rate else "as fast as possible"


def _set(command: Mapping[str, Any], _: tuple[str, ...]) -> str:
    pairs = command["settings"].items()
    return "set " + ", ".join(f"{name} to {value_in_words(name, value)}" for name, value in pairs)


_WORDS: dict[str, Callable[[Mapping[str, Any], tuple[str, ...]], str]] = {
    "pause": lambda command, names: "pause",
    "resume": lambda command, names: "resume",
    "step": lambda command, names: f"{command.get('count', 1)} more steps",
    "speed": _speed,
    "kill": lambda command, names: f"kill node {names[command['node']]}",
    "restart": lambda command, names: f"restart node {names[command['node']]}",
    "cut": lambda command, names: f"cut {_link(command, names)}",
    "heal": lambda command, names: f"heal {_link(command, names)}",
    "loss": lambda command, names: (
        f"lose {100 * command['probability']:.0f} % of the frames on {_link(command, names)}"
    ),
    "partition": lambda command, names: (
        f"cut nodes {', '.join(names[node] for node in command['nodes'])} off from the others"
    ),
    "fault": _fault,
    "calm": lambda command, names: "withdraw all faults",
    "set": _set,
}


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
