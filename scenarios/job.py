"""What a launcher and the zygote say to each other, one JSON object a line."""

import msgspec

from nodes.tempo import Tempo
from scenarios.setup import Setup


class Job(msgspec.Struct, frozen=True):
    """What the launcher asks for; `port` is the first of the user's choice, None for free ones;
    `tempo` that of real time, None for lockstep."""

    setup: Setup
    run: str
    recording: str
    port: int | None
    tempo: Tempo | None = None


class Happened(msgspec.Struct, frozen=True, omit_defaults=True):
    """What the launcher is told: started, ready, step, ended, done, refused or failed.

    `pids` are all that live, by name; watchers connect to all of `connect`.
    """

    what: str
    step: int = 0
    seconds: float = 0.0
    pids: dict[str, int] = {}
    connect: list[str] = []
    detail: str = ""


class Order(msgspec.Struct, frozen=True):
    """What the world wants of the zygote: tolerate (ends of nodes, from now on), kill, start."""

    what: str
    node: int = 0
