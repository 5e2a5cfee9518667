"""Decisions of the environment process about nodes: who is in, who is out, what is started.

Nothing here sends, waits, starts processes or reads a clock: a notice gives actions. The loop of
the environment process carries them out, and so does simulation testing under a virtual clock.
"""

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

from concord.nodes.changes import Event, Gone, Present, Settings
from concord.nodes.commands import Command, Scripted
from concord.nodes.environment_state import EnvironmentConfig
from concord.nodes.messages import EnvironmentEvent, EnvironmentMessage, Unreachable
from concord.nodes.run_controller import ProcessStarter, RunController
from concord.runtime.processes.environment.notices import (
    Hello,
    Notice,
    Presence,
    RecorderCaughtUp,
    Repeated,
)
from concord.runtime.processes.environment.pacing import EnvironmentPacing
from concord.runtime.processes.environment.timetable import Beat
from concord.runtime.processes.job import NodeEnded


class Disagreement(Exception):
    """A node was started with another configuration than the environment."""


class Deserted(Exception):
    """Every node is gone."""


def compare(hello: Hello, fingerprint: str) -> None:
    """Compare a node's configuration with the environment's.

    Raises:
        Disagreement: it does not.
    """
    if hello.fingerprint != fingerprint:
        raise Disagreement(
            f"node {hello.node} runs configuration {hello.fingerprint[:12]!r}, the environment "
            f"{fingerprint[:12]!r}; give all the same setup and version"
        )


# An environment process that stood still for longer than its lease finds all nodes gone. Links come
# back within a second or two, on a busy machine in three times that.
_RETURN_S = 6.0
# From one word that a node was given up to the next, until it asks to be let in.
_TOLD_AGAIN_S = 1.0
_FALSELY_ABSENT = (
    "node {} took node {} for out, which takes part: a message was forged or lost; all nodes are "
    "told that it takes part (docs/security.md)"
)


class StartNode(NamedTuple):
    """Start a process of a node; `life` numbers it, 0 for the first."""

    node: int
    life: int


class KillNode(NamedTuple):
    """End the process of a node that left on command."""

    node: int


class TellOut(NamedTuple):
    """Tell a node that has come back that it was given up."""

    node: int


class LookAgain(NamedTuple):
    """Give notice of `StillOut` after so long: a link that has just come back does not know yet who
    listens, and drops what is said on it."""

    node: int
    seconds: float


class Remind(NamedTuple):
    """Tell the nodes among these that are there that they were given up."""

    nodes: tuple[int, ...]


class AwaitReturn(NamedTuple):
    """No node is left: give notice of `Alone` after so long."""

    seconds: float


class Tell(NamedTuple):
    """Say a line to the user."""

    line: str


class Refuse(NamedTuple):
    """Count a message that cannot be used, and say why."""

    why: str


Action = (
    EnvironmentMessage
    | StartNode
    | KillNode
    | TellOut
    | LookAgain
    | Remind
    | AwaitReturn
    | Tell
    | Refuse
)


class EnvironmentDecisions:
    """The run controller, and the processes of nodes as the environment process knows them.

    Where it `keeps_nodes` it can start and end their processes; others run on other hosts.
    """

    def __init__(
        self,
        config: EnvironmentConfig,
        fingerprint: str,
        pacing: EnvironmentPacing,
        script: Sequence[Scripted],
        check: Callable[[Settings, Settings], Settings],
        keeps_nodes: bool,
    ) -> None:
        self._fingerprint, self._pacing, self._keeps_nodes = fingerprint, pacing, keeps_nodes
        # Nodes that leave on command, until the recorder has kept what they said; then nodes whose
        # processes are being killed.
        self._leaving, self._dying = set[int](), set[int]()
        # An end may be told after the next start was ordered: the newest process of each node.
        self._newest_life = [0] * config.nodes
        self._actions: list[Action] = []
        starter = ProcessStarter(self._leaving.add, self._start_node, check)
        self.controller = RunController(pacing.configured(config), script, starter, pacing.timed)

    def command(self, command: Command) -> list[Action]:
        """Obey.

        Raises:
            ValueError: the command cannot be obeyed.
        """
        return self.done(self.controller.command(command))

    def take(self, event: EnvironmentEvent) -> list[Action]:
        """Give the environment a message of a node, or the end of a wait."""
        messages = self.controller.take(event)
        lines = [
            Tell(_FALSELY_ABSENT.format(change.mistaken, change.node))
            for message in messages
            if isinstance(message, Event) and isinstance(change := message.change, Present)
        ]
        return [*lines, *self.done(messages)]

    def attend(self, notice: Notice) -> list[Action]:
        """Return what a notice asks for."""
        match notice:
            case Repeated(event):
                # An event that has come before changes nothing, and is no mistake.
                return self.take(event)
            case Presence(node, is_there):
                return self._see(node, is_there)
            case Hello():
                return self._let_in(notice)
            case RecorderCaughtUp(node):
                return self._end(node)
            case NodeEnded(node, life):
                return self._hear_of_end(node, life)
            case Beat():
                messages = self.done(self.controller.tick())
                return [*messages, Remind(self.controller.state.standing.absent)]
            case Unreachable(node, neighbour):
                # Frames between the two are lost: one is out until there is a link again.
                absent = self.controller.state.standing.absent
                if node not in absent and neighbour not in absent:
                    return self._give_up(neighbour)
        return []

    def end_if_deserted(self, missing: Collection[int]) -> None:
        """End the run if no node takes part and all are out of reach.

        Raises:
            Deserted: so it is.
        """
        if self.controller.deserted and len(missing) == len(self._newest_life):
            raise Deserted("no node is left")

    def done(self, messages: Sequence[EnvironmentMessage]) -> list[Action]:
        """Return the messages after the processes that a change has started."""
        started, self._actions = self._actions, []
        return [*started, *messages]

    def _hear_of_end(self, node: int, life: int) -> list[Action]:
        if life != self._newest_life[node]:
            return []
        return self.done(self.controller.not_started(node))

    def _see(self, node: int, is_there: bool) -> list[Action]:
        if not is_there:
            self._dying.discard(node)
            self.controller.lost(node)
            return self._give_up(node)
        # A node that was given up may have been out of reach only: it must know.
        absent = self.controller.state.standing.absent
        return [TellOut(node), LookAgain(node, _TOLD_AGAIN_S)] if node in absent else []

    def _let_in(self, hello: Hello) -> list[Action]:
        if hello.fingerprint != self._fingerprint:
            return [Refuse(f"node {hello.node} comes with another setup; refused")]
        if hello.node in self._leaving | self._dying:
            # A node that is told of its own end asks to be let in until its process is killed.
            return []
        ended: list[Action] = []
        if hello.node not in self.controller.state.standing.absent:
            # It was started again before its end was seen.
            ended = self.take(Gone(hello.node))
        return [*ended, *self.done(self.controller.ready(hello.node))]

    def _end(self, node: int) -> list[Action]:
        if node not in self._leaving:
            return [Refuse(f"node {node} was not to leave")]
        self._leaving.discard(node)
        self._dying.add(node)
        return [KillNode(node)]

    def _give_up(self, node: int) -> list[Action]:
        actions = self.take(Gone(node))
        if not self.controller.deserted:
            return actions
        # This process may be the one that was cut off, or stood still: it waits for the nodes.
        closed = self._pacing.without_nodes(self.controller.state.released)
        if closed is not None:
            actions += self.take(closed)
        return [*actions, AwaitReturn(_RETURN_S)] if self._keeps_nodes else actions

    def _start_node(self, node: int) -> bool:
        self._leaving.discard(node)
        self._dying.discard(node)
        self._newest_life[node] += 1
        self._actions.append(StartNode(node, self._newest_life[node]))
        return False
