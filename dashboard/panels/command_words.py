"""Commands as a person says them, with the names of the nodes."""

from collections.abc import Callable, Mapping
from typing import Any

from concord.dashboard.frames.network import value_in_words
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
