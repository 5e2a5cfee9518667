"""Notices to the loop of the environment process, and its answer to how the network stands."""

from queue import SimpleQueue
from typing import NamedTuple

import msgspec

from concord.nodes.changes import Standing
from concord.nodes.commands import Answer
from concord.nodes.messages import Bid, BidsClosed, Estimate, StepClosed, Unreachable
from concord.runtime.processes.environment.timetable import Beat
from concord.runtime.processes.job import NodeEnded


class Presence(NamedTuple):
    """A node's process has come, or is gone."""

    node: int
    is_there: bool


class StillOut(NamedTuple):
    """A node that has come back was told some time ago that it was given up."""

    node: int


class Hello(NamedTuple):
    """A node says that it is ready, and with which configuration."""

    node: int
    fingerprint: str


class Repeated(NamedTuple):
    """A node repeats a message."""

    event: Bid | Estimate


class RecorderCaughtUp(NamedTuple):
    """The recorder has kept all messages of a node that leaves on command."""

    node: int


class Asked(NamedTuple):
    """A command came; the answer goes to a queue."""

    payload: bytes
    answer: SimpleQueue[Answer]


class Alone(NamedTuple):
    """No node has been left for some seconds."""


Notice = (
    Alone
    | Presence
    | StillOut
    | Hello
    | Repeated
    | RecorderCaughtUp
    | NodeEnded
    | Asked
    | Beat
    | Unreachable
    | BidsClosed
    | StepClosed
)


class NetworkState(msgspec.Struct, frozen=True):
    """The answer to the question how the network stands.

    `refused` counts messages that could not be decoded or used.
    """

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
