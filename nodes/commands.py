"""Commands that a user may give to a running network, their bytes, and their words.

The words are those of `concord control` and of scripts: `kill 3`, `cut 1 2`, `loss 0.1 1 2`,
`corrupt 0.05`, `set rule=hcmci rounds=2`; those of faults are in `nodes/faults/vocabulary.py`.
"""

import difflib
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import msgspec

from concord.nodes.bounds import UNREADABLE
from concord.nodes.changes import (
    Settings,
)
from concord.nodes.faults.vocabulary import CHANNELS, COMMANDS, FAULTS, usage

MAX_COMMAND_BYTES = 65_536


class Pause(msgspec.Struct, frozen=True, tag="pause", tag_field="do"):
    """No further step begins."""


class Resume(msgspec.Struct, frozen=True, tag="resume", tag_field="do"):
    """Go on after a pause."""


class Step(msgspec.Struct, frozen=True, tag="step", tag_field="do", forbid_unknown_fields=True):
    """While paused: so many steps more."""

    count: int = 1


class Speed(msgspec.Struct, frozen=True, tag="speed", tag_field="do", forbid_unknown_fields=True):
    """At most so many steps per second; 0 is as fast as possible."""

    steps_per_second: float


class Kill(msgspec.Struct, frozen=True, tag="kill", tag_field="do", forbid_unknown_fields=True):
    """End a node's process without a word."""

    node: int


class Restart(
    msgspec.Struct, frozen=True, tag="restart", tag_field="do", forbid_unknown_fields=True
):
    """A fresh process for a node that is out."""

    node: int


class CutLink(msgspec.Struct, frozen=True, tag="cut", tag_field="do", forbid_unknown_fields=True):
    """Lose everything on a link, in both directions unless `both` is false."""

    sender: int
    receiver: int
    both: bool = True


class HealLink(msgspec.Struct, frozen=True, tag="heal", tag_field="do", forbid_unknown_fields=True):
    """A link is no longer cut; without nodes no link is."""

    sender: int | None = None
    receiver: int | None = None
    both: bool = True


class Partition(
    msgspec.Struct, frozen=True, tag="partition", tag_field="do", forbid_unknown_fields=True
):
    """Cut every link between these nodes and the others."""

    nodes: tuple[int, ...]


class Inject(msgspec.Struct, frozen=True, tag="fault", tag_field="do", forbid_unknown_fields=True):
    """A fault of this kind, at these nodes or this link (`nodes/faults/vocabulary.py`)."""

    kind: str
    nodes: tuple[int, ...] = ()
    numbers: tuple[float, ...] = ()
    both: bool = True


class Soothe(msgspec.Struct, frozen=True, tag="calm", tag_field="do", forbid_unknown_fields=True):
    """Withdraw every fault, cut and loss that was ever asked for."""


class LoseFrames(
    msgspec.Struct, frozen=True, tag="loss", tag_field="do", forbid_unknown_fields=True
):
    """Loss on a link, or on every link that was not given its own."""

    probability: float
    sender: int | None = None
    receiver: int | None = None
    both: bool = True


class Configure(msgspec.Struct, frozen=True, tag="set", tag_field="do", forbid_unknown_fields=True):
    """Other values for fields of the scenario."""

    settings: Settings


PaceCommand = Pause | Resume | Step | Speed
# Commands that may take effect while steps are under way, even if some node has missed them.
TimelyCommand = Kill | Restart | CutLink | HealLink | LoseFrames | Partition | Inject | Soothe
ChangeCommand = TimelyCommand | Configure
Command = PaceCommand | ChangeCommand

_decoder = msgspec.json.Decoder(Command)


class Refused(ValueError):
    """A command that cannot be obeyed; its message can be shown as it is."""


class Answer(msgspec.Struct, frozen=True):
    """Whether a command was accepted, or why not."""

    accepted: bool
    detail: str = ""


def read_command(data: bytes) -> Command:
    """The command that bytes mean.

    Raises:
        Refused: they mean none.
    """
    if len(data) > MAX_COMMAND_BYTES:
        raise Refused(f"a command of {len(data)} bytes; it may have {MAX_COMMAND_BYTES}")
    try:
        return _decoder.decode(data)
    except UNREADABLE as error:
        raise Refused(f"not a command: {error}") from None


def in_words(words: Sequence[str]) -> Command:
    """The command that a person has written, word by word.

    Raises:
        Refused: it is none.
    """
    both = list(words[-1:]) != [_ONE_WAY]
    given = list(words if both else words[:-1])
    verb = given[0] if given else ""
    if not verb:
        raise Refused(f"a command is missing. Commands are {', '.join(VERBS)}")
    if verb not in VERBS:
        raise Refused(f"{verb!r} is no command{offered('Commands', verb, VERBS)}")
    try:
        return _fault(given, both) if verb in FAULTS else _READERS[verb](given[1:], both)
    except (LookupError, TypeError, ValueError):
        raise Refused(f"{' '.join(words)!r}: say {VERBS[verb]}") from None


def offered(what: str, name: str, names: Iterable[str]) -> str:
    """Return the end of a complaint: the name that is near to `name`, if one is, and all names."""
    near = difflib.get_close_matches(name, names, n=1)
    offer = f": did you mean {near[0]!r}?" if near else "."
    return f"{offer} {what} are {', '.join(names)}"


def _setting(pair: str) -> tuple[str, int | float | str]:
    name, is_there, value = pair.partition("=")
    if not (name and is_there and value):
        raise ValueError(pair)
    for number in (int, float):
        try:
            return name, number(value)
        except ValueError:
            continue
    return name, value


_ONE_WAY = "one-way"
# Too few, too many or wrong words raise TypeError, ValueError or IndexError.
_READERS: dict[str, Callable[[list[str], bool], Command]] = {
    "pause": lambda rest, _: Pause(*rest),
    "resume": lambda rest, _: Resume(*rest),
    "step": lambda rest, _: Step(*map(int, rest)),
    "speed": lambda rest, _: Speed(*map(float, rest)),
    "kill": lambda rest, _: Kill(*map(int, rest)),
    "restart": lambda rest, _: Restart(*map(int, rest)),
    "cut": lambda rest, both: _of_link(CutLink, rest, both),
    "heal": lambda rest, both: _of_link(HealLink, rest, both) if rest else HealLink(),
    "loss": lambda rest, both: LoseFrames(float(rest[0]), *map(int, rest[1:]), both=both),
    "partition": lambda rest, _: Partition(tuple(map(int, rest))),
    "calm": lambda rest, _: Soothe(*rest),
    "set": lambda rest, _: Configure(dict(map(_setting, rest))),
}
# Every first word of a command, and how it goes on.
VERBS: dict[str, str] = {
    "pause": "pause",
    "resume": "resume",
    "step": "step N",
    "speed": "speed N",
    "restart": "restart NODE",
    "heal": "heal [FROM TO [one-way]]",
    "calm": "calm",
    "set": "set rule=NAME rounds=N ...",
    **{word: usage(word) for word in (*COMMANDS, *FAULTS)},
}


def _of_link(
    make: type[CutLink] | type[HealLink], nodes: Sequence[str], both: bool
) -> CutLink | HealLink:
    sender, receiver = map(int, nodes)
    return make(sender, receiver, both)


def _fault(given: Sequence[str], both: bool) -> Inject:
    """Numbers come after the nodes, but before those of a link, which may be left out."""
    kind, rest = given[0], list(given[1:])
    place, numbers = FAULTS[kind].place, len(FAULTS[kind].numbers)
    if place == "link":
        nodes, values = rest[numbers:], rest[:numbers]
    else:
        named = {"node": 1, "two nodes": 2, "channel": 1, "bus": 0}[place]
        nodes, values = rest[:named], rest[named:]
    if place == "channel":
        nodes = [str(CHANNELS.index(name)) for name in nodes]
    named_link = place == "link" and len(nodes) == 2
    half_a_link = place == "link" and nodes and not named_link
    if len(values) != numbers or half_a_link or not (both or named_link):
        raise ValueError(given)
    return Inject(kind, tuple(map(int, nodes)), tuple(map(float, values)), both)


class Scripted(NamedTuple):
    """A command that holds from a step on."""

    step: int
    command: ChangeCommand
