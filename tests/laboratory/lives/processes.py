"""Processes of nodes under a virtual clock: they start, compute, stand still and die."""

import dataclasses
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from concord.nodes import node as state_machine
from concord.nodes import node_changes
from concord.nodes.changes import Gone, Welcome
from concord.nodes.messages import Estimate, NodeEvent, NodeMessage, ShareHeard, decode
from concord.nodes.node_state import NodeConfig, NodeState, Phase
from concord.nodes.tempo import Tempo
from concord.runtime.processes.node.real_time_decisions import UNTIL_A_MESSAGE, RealTimeDecisions
from tests.laboratory.lives.virtual_clock import VirtualClock

# Processor time of an event, in s, on a processor that is not slowed down.
_WORK_S = 1e-3
_LOOK_S = 0.05


class NodeLinks(Protocol):
    """The ways out of a node's process."""

    def is_linked(self, node: int) -> bool: ...

    def hello(self, node: int) -> None: ...

    def post(self, node: int, message: NodeMessage) -> None: ...


class NodeProcess(ABC):
    """A process of a node: an inbox, work that takes time, and stops.

    `is_ready`: it has started. `config` and `state` are those of its machine.
    """

    def __init__(
        self, clock: VirtualClock, links: NodeLinks, config: NodeConfig, life: int
    ) -> None:
        self.clock, self.links, self.life = clock, links, life
        self.beginning = self.config = config
        self.state: NodeState = state_machine.initial_state(config)
        self.inbox: deque[tuple[str, bytes]] = deque()
        self.is_ready = self.is_dead = self.is_stopped = self.is_out = False
        self._work: Callable[[], None] | None = None
        self._busy_until_s = 0.0

    @property
    def node(self) -> int:
        """The node that this process is."""
        return self.beginning.index

    def enter(self) -> None:
        """Ask to be let in."""
        self.is_out = True
        self.clock.after(_LOOK_S, self._say_hello)

    def _say_hello(self) -> None:
        if self.is_stopped or not self.links.is_linked(self.node):
            self.clock.after(_LOOK_S, self._say_hello)
        elif not self.is_dead and self.is_out:
            self.links.hello(self.node)

    def hear(self, name: str, data: bytes) -> None:
        """A message arrives."""
        if self.is_ready and not self.is_dead:
            self.inbox.append((name, data))
            self.wake()

    def resume(self) -> None:
        """Go on after a stop."""
        self.is_stopped = False
        self.wake()

    def wake(self) -> None:
        """Do what is due now."""
        if self.is_dead or self.is_stopped or not self.is_ready:
            return
        while self.clock.now_s >= self._busy_until_s:
            work, self._work = self._work, None
            if work is not None:
                work()
            elif not self.go_on():
                return
            if self.is_dead or self.is_stopped:
                return

    @abstractmethod
    def go_on(self) -> bool:
        """Begin the next work, and say whether there was any."""

    def compute(self, factor: float, work: Callable[[], None]) -> None:
        """Have work done after its processor time."""
        self._busy_until_s, self._work = self.clock.now_s + factor * _WORK_S, work
        self.clock.at(self._busy_until_s, self.wake)

    def advance(self, *events: NodeEvent) -> tuple[NodeState, list[NodeMessage]]:
        """Make a step of the state machine; return the state before, and messages."""
        before = self.state
        self.state, messages = state_machine.step(self.config, before, *events)
        if self.state.phase is Phase.CHANGE:
            self.config, self.state, more = node_changes.apply(self.config, self.state)
            messages = [*messages, *more]
        return before, messages


class LockstepProcess(NodeProcess):
    """A node that waits for its neighbours: it takes each message when it comes."""

    def go_on(self) -> bool:
        """Take the next message; shares that overtake the welcome wait for it."""
        if self.is_out:
            return self._enter_on_welcome()
        if not self.inbox:
            return False
        name, data = self.inbox.popleft()
        kind, _, owner = name.partition("/")
        if kind == "welcome":
            return True
        event = ShareHeard(int(owner), data) if kind == "share" else decode(name, data)
        if event == Gone(self.node):
            self.inbox.clear()
            self.enter()
        else:
            self.compute(1.0, lambda: self._take(event))
        return True

    def _enter_on_welcome(self) -> bool:
        for name, data in self.inbox:
            if name.startswith("welcome/"):
                welcome: Welcome = decode(name, data)
                self.config, self.state = node_changes.begin_late(self.beginning, welcome)
                shares = [one for one in self.inbox if one[0].startswith(("share/", "measured/"))]
                self.inbox, self.is_out = deque(shares), False
                return True
        return False

    def _take(self, event: NodeEvent) -> None:
        _, messages = self.advance(event)
        for message in messages:
            self.links.post(self.node, message)


class RealTimeProcess(NodeProcess):
    """A node that keeps a timetable, as the decisions of the real process say."""

    def __init__(
        self,
        clock: VirtualClock,
        links: NodeLinks,
        config: NodeConfig,
        life: int,
        tempo: Tempo,
        start_s: float,
    ) -> None:
        super().__init__(clock, links, dataclasses.replace(config, timed=True), life)
        self.decisions = RealTimeDecisions(config, tempo)
        self.decisions.timetable.start_s = start_s

    def _say_hello(self) -> None:
        super()._say_hello()
        self.decisions.asked(self.clock.now_s)

    def go_on(self) -> bool:
        """Take the next message or pass a deadline, as the process's loop does."""
        now_s = self.clock.now_s
        if self.is_out:
            return self._enter_on_welcome()
        if self.state.phase is Phase.FINISHED:
            return False
        if self.decisions.has_to_enter(self.state, now_s):
            self._skip_ahead()
            return True
        until_s = self.decisions.wait_until_s(self.config, self.state)
        in_time = now_s < until_s or self.decisions.takes_what_waits(self.state)
        if self.inbox and in_time:
            events = self.decisions.take(self.state, *self.inbox.popleft(), now_s)
            self._ask_if_due()
        elif now_s >= until_s:
            events = self.decisions.pass_deadline(self.config, self.state, len(self.inbox))
        else:
            if until_s != UNTIL_A_MESSAGE:
                self.clock.at(until_s, self.wake)
            return False
        slow = self.config.faults.at("slow-cpu", self.state.step, self.node)
        self.compute(max(1.0, slow[0]) if slow else 1.0, lambda: self._take(events))
        return True

    def _enter_on_welcome(self) -> bool:
        if not self.inbox:
            return False
        now_s = self.clock.now_s
        welcome = self.decisions.welcome_in(*self.inbox.popleft(), now_s)
        if welcome is not None:
            config, self.state = self.decisions.begin_late(self.beginning, welcome, now_s)
            self.config, self.is_out = dataclasses.replace(config, timed=True), False
        self._ask_if_due()
        return True

    def _ask_if_due(self) -> None:
        if self.decisions.has_to_ask:
            self.decisions.asked(self.clock.now_s)
            self.links.hello(self.node)

    def _skip_ahead(self) -> None:
        self.decisions.skip_ahead()
        self.inbox.clear()
        self.enter()

    def _take(self, events: Sequence[NodeEvent]) -> None:
        self.config, self.state = self.decisions.settle(self.config, self.state)
        before, messages = self.advance(*events)
        for message in messages:
            if not isinstance(message, Estimate):
                self.links.post(self.node, message)
                continue
            _, dated = self.decisions.dated(message, self.clock.now_s)
            if dated is not None:
                self.links.post(self.node, dated)
            elif self.state.phase is not Phase.FINISHED:
                self._skip_ahead()
                return
        self.decisions.note(self.config, before, self.state, self.clock.now_s)
