"""What a person may ask of a network that runs: commands, their bytes, and their words.

The words are those of `concord control` and of scripts: `kill 3`, `cut 1 2`, `loss 0.1 1 2`,
`set rule=hcmci rounds=2`.
"""

from collections.abc import Callable, Sequence

import msgspec

from nodes.changes import Settings, Standing

MAX_COMMAND_BYTES = 4096
MAX_STEPS_AT_ONCE = 1000
MAX_STEPS_PER_SECOND = 1000.0
MAX_ROUNDS = 100
SETTINGS = ("rule", "rounds", "occupancy", "schedule", "arbiter", "hold", "decay", "trigger")


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
    """A link is no longer cut."""

    sender: int
    receiver: int
    both: bool = True


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
ChangeCommand = Kill | Restart | CutLink | HealLink | LoseFrames | Configure
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
    except msgspec.MsgspecError as error:
        raise Refused(f"not a command: {error}") from None


def check_command(
    command: Command, neighbours: Sequence[Sequence[int]], standing: Standing, paused: bool
) -> None:
    """Refuse what cannot be obeyed in a network that stands so.

    Raises:
        Refused: naming the command, its value and the rule.
    """
    match command:
        case Pause() | Resume() | Configure():
            pass
        case Step(count):
            _require(paused, f"step {count}", "the network runs; pause it first")
            allowed = 1 <= count <= MAX_STEPS_AT_ONCE
            _require(allowed, f"step {count}", f"must be 1 to {MAX_STEPS_AT_ONCE}")
        case Speed(rate):
            allowed = 0 <= rate <= MAX_STEPS_PER_SECOND
            _require(allowed, f"speed {rate:g}", f"must be 0 to {MAX_STEPS_PER_SECOND:g} steps/s")
        case Kill(node):
            _check_node(f"kill {node}", node, neighbours)
            _require(node not in standing.absent, f"kill {node}", "the node is out already")
            alone = len(standing.absent) + 1 == len(neighbours)
            _require(not alone, f"kill {node}", "it is the last one; end the run instead")
        case Restart(node):
            _check_node(f"restart {node}", node, neighbours)
            _require(node in standing.absent, f"restart {node}", "the node is not out")
        case CutLink(sender, receiver, both):
            _check_link("cut", sender, receiver, both, neighbours)
        case HealLink(sender, receiver, both):
            _check_link("heal", sender, receiver, both, neighbours)
        case LoseFrames(probability, sender, receiver, both):
            allowed = 0 <= probability < 1
            _require(allowed, f"loss {probability:g}", "must be at least 0 and below 1")
            if sender is not None and receiver is not None:
                _check_link("loss on", sender, receiver, both, neighbours)
            else:
                whole = sender is None and receiver is None
                _require(whole, f"loss {probability:g}", "name both ends of the link, or neither")


def in_words(words: Sequence[str]) -> Command:
    """The command that a person has written, word by word.

    Raises:
        Refused: it is none.
    """
    both = list(words[-1:]) != [_ONE_WAY]
    said = list(words if both else words[:-1])
    try:
        return _VERBS[said[0]](said[1:], both)
    except (LookupError, TypeError, ValueError):
        raise Refused(
            f"{' '.join(words)!r} is no command; say pause, resume, step N, speed N, kill NODE, "
            "restart NODE, cut FROM TO [one-way], heal FROM TO [one-way], "
            "loss P [FROM TO [one-way]] or set rule=NAME rounds=N ..."
        ) from None


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


def _check_node(what: str, node: int, neighbours: Sequence[Sequence[int]]) -> None:
    there = 0 <= node < len(neighbours)
    _require(there, what, f"there are nodes 0 to {len(neighbours) - 1}")


def _check_link(
    verb: str, sender: int, receiver: int, both: bool, neighbours: Sequence[Sequence[int]]
) -> None:
    what = f"{verb} {sender} {receiver}"
    for node in (sender, receiver):
        _check_node(what, node, neighbours)
    heard = sender in neighbours[receiver] or (both and receiver in neighbours[sender])
    _require(heard, what, f"node {receiver} does not hear node {sender}")


def _require(holds: bool, what: str, why: str) -> None:
    if not holds:
        raise Refused(f"{what}: {why}")


_ONE_WAY = "one-way"
# Too few, too many or wrong words raise TypeError, ValueError or IndexError.
_VERBS: dict[str, Callable[[list[str], bool], Command]] = {
    "pause": lambda rest, _: Pause(*rest),
    "resume": lambda rest, _: Resume(*rest),
    "step": lambda rest, _: Step(*map(int, rest)),
    "speed": lambda rest, _: Speed(*map(float, rest)),
    "kill": lambda rest, _: Kill(*map(int, rest)),
    "restart": lambda rest, _: Restart(*map(int, rest)),
    "cut": lambda rest, both: _of_link(CutLink, *map(int, rest), both=both),
    "heal": lambda rest, both: _of_link(HealLink, *map(int, rest), both=both),
    "loss": lambda rest, both: LoseFrames(float(rest[0]), *map(int, rest[1:]), both=both),
    "set": lambda rest, _: Configure(dict(map(_setting, rest))),
}


def _of_link(
    make: type[CutLink] | type[HealLink], sender: int, receiver: int, *, both: bool
) -> Command:
    return make(sender, receiver, both)
