"""The faults there are, as data: each one's word, what comes after it, and how it is withdrawn.

`nodes/commands.py` reads the words; docs/faults.md says what each fault means.
"""

from typing import Literal, NamedTuple

Place = Literal["link", "node", "two nodes", "nodes", "channel", "bus"]
Need = Literal[
    "", "a cluster", "two channels", "shares of numbers", "shares of beliefs", "a sensor"
]


class Number(NamedTuple):
    """One number after a word, from `least` to `most`."""

    name: str
    least: float
    most: float
    is_whole: bool = False


class FaultWord(NamedTuple):
    """One kind of fault.

    Attributes:
        family: what it happens to: links, nodes, sensors, bus, malice.
        place: whom the word names: `link` may be left out, and then means every link.
        numbers: how much of it, in order. The first one is 0 where the fault is withdrawn.
        example: it in words, on a network of four nodes on a ring. withdrawal: how it ends, in
        words; "" where it ends by itself. needs: without which it is refused.
    """

    family: str
    place: Place
    numbers: tuple[Number, ...]
    example: str
    withdrawal: str
    summary: str
    needs: Need = ""


_P = Number("P", 0, 1)
_CYCLES = Number("CYCLES", 0, 64, True)
_STEPS = Number("STEPS", 0, 1_000_000, True)
_SIZE = Number("SIZE", -1e6, 1e6)

# Faults that have a command of their own: the code below does not read this table.
COMMANDS: dict[str, FaultWord] = {
    "kill": FaultWord("nodes", "node", (), "kill 3", "restart 3", "a node's process ends"),
    "cut": FaultWord("links", "link", (), "cut 1 2", "heal 1 2", "a link loses everything"),
    "loss": FaultWord(
        "links",
        "link",
        (Number("P", 0, 0.99),),
        "loss 0.1 1 2",
        "loss 0 1 2",
        "a link loses frames",
    ),
    "partition": FaultWord(
        "links", "nodes", (), "partition 0 1", "heal", "these nodes and the others are cut apart"
    ),
}  # fmt: skip

# Faults that share one command, `concord.nodes.commands.Inject`, and one change,
# `concord.nodes.changes.Fault`.
FAULTS: dict[str, FaultWord] = {
    "corrupt": FaultWord(
        "links", "link", (_P,), "corrupt 0.05 1 2", "corrupt 0 1 2",
        "one to three bits of a frame are flipped on its way",
    ),
    "delay": FaultWord(
        "links", "link", (_P, _CYCLES), "delay 0.2 3 1 2", "delay 0 3 1 2",
        "a frame comes so many cycles late",
    ),
    "jitter": FaultWord(
        "links", "link", (_CYCLES,), "jitter 2 1 2", "jitter 0 1 2",
        "a frame comes 0 to so many cycles late",
    ),
    "duplicate": FaultWord(
        "links", "link", (_P,), "duplicate 0.2 1 2", "duplicate 0 1 2", "a frame comes twice"
    ),
    "reorder": FaultWord(
        "links", "link", (_P,), "reorder 0.5 1 2", "reorder 0 1 2",
        "a frame is overtaken by all others of its cycle",
    ),
    "hang": FaultWord(
        "nodes", "node", (_STEPS,), "hang 3 5", "", "a node stands still for so many steps"
    ),
    "slow": FaultWord(
        "nodes", "node", (_CYCLES,), "slow 3 2", "slow 3 0", "all that a node says comes late"
    ),
    "slow-cpu": FaultWord(
        "nodes", "node", (Number("FACTOR", 0, 10_000),), "slow-cpu 3 4", "slow-cpu 3 0",
        "a processor takes so many times as long, in real time alone",
    ),
    "drift": FaultWord(
        "nodes", "node", (Number("PPM", -10_000, 10_000),), "drift 3 9000", "drift 3 0",
        "a node's oscillator leaves its rate; clock correction follows up to a limit", "a cluster",
    ),
    "outlier": FaultWord(
        "sensors", "node", (_P, _SIZE), "outlier 1 0.1 20", "outlier 1 0 20",
        "a reading is off by so many standard deviations, this way or that",
    ),
    "bias": FaultWord(
        "sensors", "node", (_SIZE,), "bias 1 5", "bias 1 0",
        "every reading is off by so many standard deviations",
    ),
    "stuck": FaultWord(
        "sensors", "node", (_STEPS,), "stuck 1 5", "",
        "readings repeat the last one for so many steps",
    ),
    "dropout": FaultWord(
        "sensors", "node", (_P,), "dropout 1 0.3", "dropout 1 0", "a step brings no reading"
    ),
    "missing": FaultWord(
        "bus", "node", (_P,), "missing 3 0.2", "missing 3 0", "a node leaves its slots empty"
    ),
    "crc": FaultWord(
        "bus", "node", (_P,), "crc 3 0.2", "crc 3 0", "a node sends a frame with a wrong checksum"
    ),
    "null": FaultWord(
        "bus", "node", (_P,), "null 3 0.2", "null 3 0", "a node sends a null frame"
    ),
    "babble": FaultWord(
        "bus", "node", (_P,), "babble 3 0.5", "babble 3 0",
        "a babbling idiot: noise in slots that are not its own",
    ),
    "guardian": FaultWord(
        "bus", "bus", (Number("ON", 0, 1, True),), "guardian 1", "guardian 0",
        "a bus guardian blocks what babbles in slots with an owner",
    ),
    "channel": FaultWord(
        "bus", "channel", (_P,), "channel B 1", "channel B 0",
        "a channel loses frames, which come by the other one", "two channels",
    ),
    "spoof": FaultWord(
        "malice", "two nodes", (_P,), "spoof 3 2 0.2", "spoof 3 2 0",
        "the first node also sends in the name of the second",
    ),
    "wrong-step": FaultWord(
        "malice", "node", (_P, _CYCLES), "wrong-step 3 0.2 3", "wrong-step 3 0 3",
        "a frame carries the number of an earlier cycle",
    ),
    "replay": FaultWord(
        "malice", "node", (_P, _CYCLES), "replay 3 0.2 3", "replay 3 0 3",
        "a frame is sent again so many cycles later",
    ),
    "nan": FaultWord(
        "malice", "node", (_P,), "nan 3 0.2", "nan 3 0", "a share of numbers that are none",
        "shares of numbers",
    ),
    "indefinite": FaultWord(
        "malice", "node", (_P,), "indefinite 3 0.2", "indefinite 3 0",
        "a share with a covariance that is none", "shares of beliefs",
    ),
    "lie": FaultWord(
        "malice", "node", (_SIZE, Number("SHARPNESS", 1e-6, 1e6)), "lie 3 5 4", "lie 3 0 1",
        "a mean that is off by so many standard deviations, and so many times too sure of itself",
        "shares of beliefs",
    ),
}  # fmt: skip

# Faults that end by themselves, the first number of steps after they began.
PASSING = ("hang", "stuck")
CHANNELS = ("A", "B")
EVERY_FAULT = COMMANDS | FAULTS


def usage(word: str) -> str:
    """How a fault is written: `delay P CYCLES [FROM TO [one-way]]`."""
    fault = EVERY_FAULT[word]
    numbers = [number.name for number in fault.numbers]
    match fault.place:
        case "link":
            whom = ["FROM TO [one-way]"] if word == "cut" else ["[FROM TO [one-way]]"]
            parts = [*numbers, *whom]
        case "two nodes":
            parts = ["NODE", "VICTIM", *numbers]
        case "nodes":
            parts = ["NODE", "..."]
        case "channel":
            parts = ["A|B", *numbers]
        case "bus":
            parts = numbers
        case _:
            parts = ["NODE", *numbers]
    return " ".join([word, *parts])
