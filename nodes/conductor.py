"""Who decides how far the world may go, and what changes between which steps, in every driver.

Commands wait for a step that nobody has begun: the conductor holds the world back until nothing is
under way, applies what has come, and lets it go on. A script is commands with a step each, so that
a run with changes is a value too, and every driver gives the same bits for it.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import NamedTuple

from nodes import world, world_changes
from nodes.changes import (
    Calm,
    Change,
    Cut,
    Event,
    Fault,
    Healed,
    Joined,
    Left,
    Loss,
    Pace,
    Settings,
    Standing,
)
from nodes.command_checks import check_command
from nodes.commands import (
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
    Soothe,
    Speed,
    Step,
)
from nodes.fault_words import FAULTS
from nodes.messages import WorldEvent, WorldMessage
from nodes.world import WorldConfig, WorldState


class Scripted(NamedTuple):
    """A command that holds from a step on."""

    step: int
    command: ChangeCommand


class Stage(NamedTuple):
    """What a conductor can do with the processes of nodes.

    `kill(node)` ends one; `start(node)` starts a fresh one and says whether it is ready at once;
    `check(settings)` refuses with a ValueError, or completes, what may not be set.
    """

    kill: Callable[[int], None]
    start: Callable[[int], bool]
    check: Callable[[Settings], Settings]


class Conductor:
    """The world of one run, and what is to become of it.

    In a `timed` network changes hold from the step that begins next, whatever is under way.
    """

    def __init__(
        self,
        config: WorldConfig,
        script: Sequence[Scripted],
        stage: Stage,
        timed: bool = False,
    ) -> None:
        self.config, self._timed = config, timed
        self.state: WorldState = world.begin(config)
        self._script = sorted(script, key=lambda one: one.step)
        self._stage = stage
        self._pending: list[ChangeCommand] = []
        self._ready: set[int] = set()
        self._awaited: set[int] = set()
        self._pause_at: int | None = None
        self._paced_to: int | None = None
        self._rate = 0.0

    @property
    def finished(self) -> bool:
        """Every member has estimated every step."""
        return world.finished(self.config, self.state)

    @property
    def deserted(self) -> bool:
        """No node is left that could go on."""
        return not world.members(self.config, self.state)

    @property
    def paused(self) -> bool:
        """No step begins but those that are asked for."""
        return self._pause_at is not None

    @property
    def steps_per_second(self) -> float:
        """The rate that was asked for; 0 is as fast as possible."""
        return self._rate

    def begin(self) -> list[WorldMessage]:
        """The first heartbeats."""
        return self._settle()

    def take(self, event: WorldEvent) -> list[WorldMessage]:
        """What a node says, or that it is gone."""
        was_idle = self.state.idle
        self.state, messages = world.step(self.config, self.state, event)
        if self.state.idle and not was_idle:
            messages += self._settle()
        return messages

    def command(self, command: Command) -> list[WorldMessage]:
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
                wanted = {**self.state.standing.settings, **settings}
                self._pending.append(Configure(self._stage.check(wanted)))
                return self._settle()
            case _:
                self._pending.append(command)
                return self._settle()
        told = Event(self.state.released, Pace(self.paused, self._rate))
        return [told, *self._settle()]

    def ready(self, node: int) -> list[WorldMessage]:
        """A fresh process of a node waits to take part."""
        if node not in self.state.standing.absent:
            return []
        self._ready.add(node)
        return self._settle()

    def lost(self, node: int) -> None:
        """A process that was ready to take part is gone again."""
        self._ready.discard(node)

    def tick(self) -> list[WorldMessage]:
        """At a limited speed: the time has come for one more step."""
        if self._paced_to is None:
            return []
        self._paced_to = self.state.released + 1
        return self._settle()

    def _settle(self) -> list[WorldMessage]:
        """Make what changes are due, and let the world go as far as it may."""
        outbox: list[WorldMessage] = []
        if (self.state.idle or self._timed) and not self.finished:
            for command in self._due():
                with suppress(ValueError):
                    # Two commands that were both in order may not be so together.
                    self._check(command)
                    outbox += self._apply(self._changes(command))
            outbox += self._join()
        self.state, messages = world.allow(self.config, self.state, self._limit())
        return outbox + messages

    def _check(self, command: Command) -> None:
        config = self.config
        equipment = config.faults.equipment
        check_command(command, config.neighbours, self.state.standing, self.paused, equipment)

    def _due(self) -> list[ChangeCommand]:
        """What waits for a step that nobody has begun."""
        due, self._pending = self._pending, []
        while self._script and self._script[0].step <= self.state.released:
            due.append(self._script.pop(0).command)
        return due

    def _join(self) -> list[WorldMessage]:
        """Let in who is ready, if somebody can tell it what to believe."""
        outbox: list[WorldMessage] = []
        # One that joins may have left in this step alone, and can tell others what it believed.
        while able := self._able():
            self._ready -= {joined.node for joined in able}
            self._awaited -= {joined.node for joined in able}
            outbox += self._apply(able)
        self._awaited -= self._ready
        return outbox

    def _able(self) -> list[Joined]:
        joins = [
            world_changes.joining(self.config, self.state, node) for node in sorted(self._ready)
        ]
        return [joined for joined in joins if joined is not None]

    def _apply(self, changes: Sequence[Change]) -> list[WorldMessage]:
        self.config, self.state, messages = world_changes.apply(self.config, self.state, changes)
        return messages

    def _changes(self, command: ChangeCommand) -> list[Change]:
        """What a command changes in the network."""
        match command:
            case Kill(node):
                self._ready.discard(node)
                self._stage.kill(node)
                return [Left(node)]
            case Restart(node):
                # In a script the step begins with the node in it, however long its start takes;
                # the clock waits for nobody.
                if not self._timed:
                    self._awaited.add(node)
                if self._stage.start(node):
                    self._ready.add(node)
                return []
            case Configure(settings):
                # What entails what is for the scenario to say, in a script as well.
                wanted = self._stage.check({**self.state.standing.settings, **settings})
                return [world_changes.setting(self.config, self.state, wanted)]
            case Inject():
                return self._faults(command)
            case _:
                return link_changes(command, self.config.neighbours, self.state.standing)

    def _faults(self, command: Inject) -> list[Change]:
        """What a fault changes: two of them where a link has it both ways."""
        kind, nodes = command.kind, command.nodes
        is_link = FAULTS[kind].place == "link" and len(nodes) == 2
        links = partial(_links, self.config.neighbours, both=command.both)
        places = links(*nodes) if is_link else [nodes]
        released = self.state.released
        cycle = self.config.cycle_of(released)
        return [Fault(kind, tuple(place), command.numbers, released, cycle) for place in places]

    def _has_company(self, node: int) -> bool:
        return any(j not in self.state.standing.absent for j in self.config.neighbours[node])

    def _limit(self) -> int:
        """How far the world may go."""
        limits = [self.config.steps]
        if self._pending or self._awaited or self._able():
            limits.append(self.state.released)
        if any(self._has_company(node) for node in self._ready):
            # A neighbour that has come back with it can say what to believe one step later.
            limits.append(self.state.released + 1)
        if self._script:
            limits.append(self._script[0].step)
        if self._pause_at is not None:
            limits.append(self._pause_at)
        if self._paced_to is not None:
            limits.append(self._paced_to)
        return min(limits)


LinkCommand = CutLink | HealLink | LoseFrames | Partition | Soothe


def link_changes(
    command: LinkCommand, neighbours: Sequence[Sequence[int]], standing: Standing
) -> list[Change]:
    """What a command changes of links, in a network that stands so and in which node i hears
    neighbours[i]."""
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
