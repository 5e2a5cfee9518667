"""The messages of launcher, launcher process and environment process, one JSON object a line."""

import msgspec

from concord.nodes.tempo import Tempo
from concord.scenarios.setup import Setup


class HostPlace(msgspec.Struct, frozen=True):
    """The part of a network that is on this host.

    Attributes:
        cast: the names of its processes: environment and recorder, or numbers of nodes.
        connect: endpoints of routers, of which each process takes the first that answers.
        keys: the file of `concord keys` of each process, where they prove their identity.
        peer_timeout_s: how long a node goes on without the environment process.
    """

    cast: list[str]
    connect: list[str]
    keys: dict[str, str] = {}
    peer_timeout_s: float = 60.0


class Job(msgspec.Struct, frozen=True):
    """A run that the launcher asks for.

    `port` is the first of the user's choice, 0 for free ones, None for unix sockets in the folder
    `sockets`, which `run_job` makes. `tempo` is that of real time, None for lockstep. A
    lockstep network that `begins_paused` waits for a command before step 0. `place` is None where
    all is on this machine.
    """

    setup: Setup
    run: str
    recording: str
    port: int | None
    tempo: Tempo | None = None
    place: HostPlace | None = None
    sockets: str | None = None
    begins_paused: bool = False


class Happened(msgspec.Struct, frozen=True, omit_defaults=True):
    """A report to the launcher: started, ready, step, ended, repeated, done, refused or failed.

    `count` is of messages that were repeated. `pids` are all that live, by name; subscribers
    connect to all of `connect`.
    """

    what: str
    step: int = 0
    count: int = 0
    seconds: float = 0.0
    pids: dict[str, int] = {}
    connect: list[str] = []
    detail: str = ""


class Order(msgspec.Struct, frozen=True):
    """The environment process asks the launcher process: tolerate ends of nodes, kill, or start.

    `life` counts how often the environment process has started this node.
    """

    what: str
    node: int = 0
    life: int = 0


class NodeEnded(msgspec.Struct, frozen=True):
    """The launcher process tells the environment process that a node's process was killed.

    `life` is that of the order that started it, 0 for the first.
    """

    node: int
    life: int
