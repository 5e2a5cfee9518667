"""The run controller limits how far the environment may go, and applies changes between steps.

A command waits for a step that no node has begun: the run controller holds the environment back
until nothing is under way, applies the commands that have come, and lets it go on. A script is a
list of commands with a step each, so a run with changes is a value, and every driver gives the same
bits for it.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from concord.nodes import environment, environment_changes
from concord.nodes.changes import (
    Calm,
    Change,
    Cut,
    Event,
    Fault,
    Healed,
    Joined,
    Left,
    Loss,
    PaceChange,
    Settings,
    Standing,
)
from concord.nodes.command_checks import check_command
from concord.nodes.commands import (
    ChangeCommand,
    Command,
    Configure,
    CutLink,
    HealLink,
    Inject,
    Kill,
    LoseFrames,
    Partition,
    Pause,
    Restart,
    Resume,
    Scripted,
    Soothe,
    Speed,
    Step,
)
from concord.nodes.environment_state import EnvironmentConfig, EnvironmentState
from concord.nodes.faults.vocabulary import FAULTS
from concord.nodes.messages import Allowed, EnvironmentEvent, EnvironmentMessage, Estimate


class ProcessStarter(NamedTuple):
    """The means of a run controller to start and end the processes of nodes.

    `kill(node)` ends one; `start(node)` starts a fresh one and says whether it is ready at once;
    `check(before, asked)` returns all settings after a change, or refuses it with a ValueError.
    """

    kill: Callable[[int], None]
    start: Callable[[int], bool]
    check: Callable[[Settings, Settings], Settings]


class RunController:
    """The environment of one run, and the changes that lie ahead of it.

    In a `timed` network changes hold from the step that begins next, whatever is under way.
    """

    def __init__(
        self,
        config: EnvironmentConfig,
        script: Sequence[Scripted],
        stage: ProcessStarter,
        timed: bool = False,
    ) -> None:
        self.config, self._timed = config, timed
        self.state: EnvironmentState = environment.begin(config)
        self._script = sorted(script, key=lambda one: one.step)
        self._stage, self._mistaken = stage, environment_changes.MistakenNodes()
        self._pending: list[ChangeCommand] = []
        self._ready, self._awaited = set[int](), set[int]()
        self._pause_at: int | None = None
        self._paced_to: int | None = None
        self._rate = 0.0

    @property
    def finished(self) -> bool:
        """Every member has estimated every step."""
        return environment.finished(self.config, self.state)

    @property
    def deserted(self) -> bool:
        """No node is left that could go on."""
        return not environment.members(self.config, self.state)

    @property
    def _stands_still(self) -> bool:
        """Whether steps wait for the first node that returns; the clock waits for none."""
        return self.deserted and not self._timed

    @property
    def paused(self) -> bool:
        """No step begins but those that are asked for."""
        return self._pause_at is not None

    @property
    def steps_per_second(self) -> float:
        """The rate that was asked for; 0 is as fast as possible."""
        return self._rate

    def begin(self) -> list[EnvironmentMessage]:
        """The first heartbeats."""
        return self._settle()

    def take(self, event: EnvironmentEvent) -> list[EnvironmentMessage]:
        """Give the environment a message of a node, or the end of one."""
        was_idle = self.state.idle
        self.state, messages = environment.step(self.config, self.state, event)
        if isinstance(event, Estimate) and event.absent:
            messages += self._apply(self._mistaken.found(self.config, self.state, event))
        if self._stands_still or (self.state.idle and not was_idle):
            messages += self._settle()
        return messages

    def command(self, command: Command) -> list[EnvironmentMessage]:
        """Obey.

        Raises:
            ValueError: the command cannot be obeyed.
        """
        self._check(command)
        match command:
            case Pause():
                self._pause_at = self.state.released
            case Resume():
                self._pause_at = None
            case Step(count):
                self._pause_at = (self._pause_at or 0) + count
            case Speed(rate):
                self._rate, self._paced_to = rate, (self.state.released if rate else None)
            case Restart(node):
                # The network does not wait until the process is ready.
                if self._stage.start(node):
                    self._ready.add(node)
                return self._settle()
            case Configure(settings):
                waiting = [one.settings for one in self._pending if isinstance(one, Configure)]
                before = [self.state.standing.settings, *waiting][-1]
                self._pending.append(Configure(self._stage.check(before, settings)))
                return self._settle()
            case _:
                self._pending.append(command)
                return self._settle()
        return [Event(self.state.released, PaceChange(self.paused, self._rate)), *self._settle()]

    def ready(self, node: int) -> list[EnvironmentMessage]:
        """A fresh process of a node waits to take part."""
        if node not in self.state.standing.absent:
            return []
        self._ready.add(node)
        return self._settle()

    def lost(self, node: int) -> None:
        """A process that was ready to take part is gone again."""
        self._ready.discard(node)

    def not_started(self, node: int) -> list[EnvironmentMessage]:
        """The process of a node that a script restarts has ended before it was ready."""
        self._awaited.discard(node)
        return self._settle()

    def tick(self) -> list[EnvironmentMessage]:
        """At a limited speed: the time has come for one more step."""
        if self._paced_to is None:
            return []
        self._paced_to = self.state.released + 1
        return self._settle()

    def _settle(self) -> list[EnvironmentMessage]:
        """Apply changes that are due, and let the environment go as far as it may."""
        outbox: list[EnvironmentMessage] = []
        if (self.state.idle or self._timed) and not self.finished:
            for command in self._due():
                with suppress(ValueError):
                    # Two commands that were both in order may not be so together.
                    self._check(command)
                    outbox += self._apply(self._changes(command))
            outbox += self._join()
        self.state, messages = environment.step(self.config, self.state, Allowed(self._limit()))
        return outbox + messages

    def _check(self, command: Command) -> None:
        neighbours, equipment = self.config.neighbours, self.config.faults.equipment
        check_command(command, neighbours, self.state.standing, self.paused, equipment)

    def _due(self) -> list[ChangeCommand]:
        """Take the commands that wait for a step that no node has begun."""
        due, self._pending = self._pending, []
        while self._script and self._script[0].step <= self.state.released:
            due.append(self._script.pop(0).command)
        return due

    def _join(self) -> list[EnvironmentMessage]:
        """Let in each ready node, if a neighbour can tell it what to believe."""
        outbox: list[EnvironmentMessage] = []
        # A node that joins may have left in this step alone, and can tell others what it believed.
        while able := self._able():
            self._ready -= {joined.node for joined in able}
            self._awaited -= {joined.node for joined in able}
            outbox += self._apply(able)
        self._awaited -= self._ready
        return outbox

    def _able(self) -> list[Joined]:
        joins = [
            environment_changes.joining(self.config, self.state, node)
            for node in sorted(self._ready)
        ]
        return [joined for joined in joins if joined is not None]

    def _apply(self, changes: Sequence[Change]) -> list[EnvironmentMessage]:
        self.config, self.state, messages = environment_changes.apply(
            self.config, self.state, changes
        )
        return messages

    def _changes(self, command: ChangeCommand) -> list[Change]:
        """Return the changes of a command."""
        match command:
            case Kill(node):
                self._ready.discard(node)
                self._stage.kill(node)
                return [Left(node)]
            case Restart(node):
                # In a script the step begins with the node in it, however long its start takes;
                # the clock waits for no node.
                if not self._timed:
                    self._awaited.add(node)
                if self._stage.start(node):
                    self._ready.add(node)
                return []
            case Configure(settings):
                wanted = self._stage.check(self.state.standing.settings, settings)
                return [environment_changes.setting(self.config, self.state, wanted)]
            case Inject():
                return fault_changes(command, self.config, self.state.released)
            case _:
                return link_changes(command, self.config.neighbours, self.state.standing)

    def _limit(self) -> int:
        """The step before which the environment stops."""
        limits = [self.config.steps]
        if self._pending or self._awaited or self._stands_still or self._able():
            limits.append(self.state.released)
        absent = set(self.state.standing.absent)
        if any(set(self.config.neighbours[node]) - absent for node in self._ready):
            # A neighbour that has come back with it can say what to believe one step later.
            limits.append(self.state.released + 1)
        if self._script:
            limits.append(self._script[0].step)
        limits += [step for step in (self._pause_at, self._paced_to) if step is not None]
        return min(limits)


def fault_changes(command: Inject, config: EnvironmentConfig, step: int) -> list[Change]:
    """Return the changes of a fault that begins at a step: two where a link has it both ways."""
    kind, nodes = command.kind, command.nodes
    is_link = FAULTS[kind].place == "link" and len(nodes) == 2
    places = _links(config.neighbours, *nodes, both=command.both) if is_link else [nodes]
    cycle = config.cycle_of(step)
    return [Fault(kind, tuple(place), command.numbers, step, cycle) for place in places]


LinkCommand = CutLink | HealLink | LoseFrames | Partition | Soothe


def link_changes(
    command: LinkCommand, neighbours: Sequence[Sequence[int]], standing: Standing
) -> list[Change]:
    """Return the changes of a command to links; node i hears neighbours[i]."""
    match command:
        case CutLink(sender, receiver, both):
            return [Cut(*link) for link in _links(neighbours, sender, receiver, both=both)]
        case HealLink(int(sender), int(receiver), both):
            return [Healed(*link) for link in _links(neighbours, sender, receiver, both=both)]
        case HealLink():
            return [Healed(*link) for link in standing.cuts]
        case Partition(nodes):
            return [Cut(*link) for link in _crossing(neighbours, set(nodes))]
        case LoseFrames(probability, int(sender), int(receiver), both):
            links = _links(neighbours, sender, receiver, both=both)
            return [Loss(probability, *link) for link in links]
        case LoseFrames(probability):
            return [Loss(probability)]
        case Soothe():
            return [Calm()]


def _links(
    neighbours: Sequence[Sequence[int]], sender: int, receiver: int, *, both: bool
) -> list[tuple[int, int]]:
    directions = [(sender, receiver), (receiver, sender)] if both else [(sender, receiver)]
    return [(s, r) for s, r in directions if s in neighbours[r]]


def _crossing(neighbours: Sequence[Sequence[int]], nodes: set[int]) -> list[tuple[int, int]]:
    """Links between these nodes and the others, either way."""
    return [
        (sender, receiver)
        for receiver, heard in enumerate(neighbours)
        for sender in heard
        if (sender in nodes) != (receiver in nodes)
    ]
