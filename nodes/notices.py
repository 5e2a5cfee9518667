"""What a world's process is told beside the messages of nodes, and how it says that it stands."""

from queue import SimpleQueue
from typing import NamedTuple

import msgspec

from nodes.changes import Standing
from nodes.commands import Answer
from nodes.messages import Bid, BidsClosed, Estimate, StepClosed, Unreachable
from nodes.world_timetable import Beat


class Presence(NamedTuple):
    """A node's process has come, or is gone."""

    node: int
    is_there: bool


class Hello(NamedTuple):
    """A node says that it is ready, and with which configuration."""

    node: int
    fingerprint: str


class Repeated(NamedTuple):
    """What a node says once more."""

    event: Bid | Estimate


class Recorded(NamedTuple):
    """All that a node has said that leaves on command."""

    node: int


class Asked(NamedTuple):
    """Somebody has asked for something; the answer goes to a queue."""

    payload: bytes
    answer: SimpleQueue[Answer]


Notice = (
    Presence | Hello | Repeated | Recorded | Asked | Beat | Unreachable | BidsClosed | StepClosed
)


class State(msgspec.Struct, frozen=True):
    """What the world answers to whoever asks how the network stands; it has `refused` so many
    messages that were none."""

    run: str
    setup: msgspec.Raw
    begun: bool
    completed: int
    released: int
    paused: bool
    steps_per_second: float
    members: list[int]
    standing: Standing
    refused: int
