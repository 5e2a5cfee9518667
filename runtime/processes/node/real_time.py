"""Real time at a node: it goes on when the clock says so, with whatever has come.

Each node keeps a timetable (`nodes/tempo.py`) from a common start that the environment process
announces. A group of a cycle ends at its time; no node waits for a neighbour, and no share waits
for a receiver that is slow. A node that hears no heartbeat goes on without readings. A node that is
told that it was given up asks to be let in again. A `Timing` tells of each
step what the timetable cost. `real_time_decisions.py` decides; here are clock, queue and links.
"""

import dataclasses
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from queue import Empty, Full, Queue

import msgspec

from concord.nodes import node as state_machine
from concord.nodes.changes import Welcome
from concord.nodes.messages import END, Estimate, NodeEvent, NodeMessage, encode, topic
from concord.nodes.node_state import NodeConfig, NodeState, Phase
from concord.nodes.tempo import Tempo
from concord.runtime.network.links import ENVIRONMENT
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.clock import EnvironmentClock, ahead_s
from concord.runtime.processes.node.membership import Membership, await_links
from concord.runtime.processes.node.process import GivenUp
from concord.runtime.processes.node.real_time_decisions import UNTIL_A_MESSAGE, RealTimeDecisions
from concord.runtime.processes.peer_timeout import PeerTimeout

_MOST = 65_536


class Mailbox:
    """Messages (topic, bytes) of some topics, in the order in which they came."""

    def __init__(self, transport: Transport, topics: Sequence[str]) -> None:
        self.ended = threading.Event()
        self._queue: Queue[tuple[str, bytes]] = Queue(_MOST)
        transport.listen("end", self._hear_end)
        for heard in topics:
            transport.listen(heard, self._hear)

    def get(self) -> tuple[str, bytes]:
        """Wait for the next message."""
        return self._queue.get()

    def get_within(self, seconds: float) -> tuple[str, bytes]:
        """Wait for the next message.

        Raises:
            Empty: none came in time.
        """
        if seconds <= 0:
            raise Empty
        return self._queue.get(timeout=seconds)

    def get_waiting(self) -> tuple[str, bytes]:
        """A message that is there already.

        Raises:
            Empty: there is none.
        """
        return self._queue.get_nowait()

    def clear(self) -> None:
        """Drop the messages that are there already."""
        with suppress(Empty):
            for _ in range(self._queue.qsize()):
                self._queue.get_nowait()

    def waiting(self) -> int:
        """The number of messages that are there already."""
        return self._queue.qsize()

    def _hear(self, name: str, data: bytes) -> None:
        """Drop the message when the mailbox is full: blocking would stall every subscription.

        Runs on: a thread of zenoh's.
        """
        with suppress(Full):
            self._queue.put_nowait((name, data))

    def _hear_end(self, name: str, data: bytes) -> None:
        """Runs on: a thread of zenoh's."""
        if data == END:
            self.ended.set()
        else:
            self._hear(name, data)


_ASK_AGAIN_S = 1.0


class StartTime:
    """Asks the environment process for the common start."""

    def __init__(self, transport: Transport) -> None:
        self._transport, self._ahead_s = transport, 0.0
        self._announced = threading.Event()
        transport.listen("start", lambda name, data: self._announced.set())

    def compare_clocks(self) -> None:
        """Measure how far another host's clock is ahead of this one's."""
        self._ahead_s = ahead_s(self._their_time)

    def wait(self) -> float:
        """Wait until the start is known; when step 0 begins or began, on our monotonic clock."""
        while True:
            clock = self._clock()
            if clock is not None and clock.start_s is not None:
                return clock.start_s - self._ahead_s
            # A node that is there from the beginning on hears the announcement. Another one asks
            # again: an answer may be lost on a busy machine.
            self._announced.wait(_ASK_AGAIN_S)
            self._announced.clear()

    def _clock(self) -> EnvironmentClock | None:
        answer = self._transport.ask("clock")
        return None if answer is None else msgspec.json.decode(answer, type=EnvironmentClock)

    def _their_time(self) -> float | None:
        clock = self._clock()
        return None if clock is None else clock.now_s


class SlowProcessor:
    """Adds processor time to the work of the thread that calls it.

    `used_s` returns the processor time that this thread has used so far.
    """

    def __init__(self, used_s: Callable[[], float] = time.thread_time) -> None:
        self._used_s, self._since_s = used_s, used_s()

    def work(self, factor: float) -> None:
        """Compute on until the work since the last call has taken `factor` times its time."""
        until_s = self._since_s + factor * (self._used_s() - self._since_s)
        while self._used_s() < until_s:
            # The thread must use the processor: a pause would leave it to other nodes.
            pass
        self._since_s = self._used_s()


class RealTimeNode:
    """Paces a node by the clock: what does not come in time is missed."""

    def __init__(self, membership: Membership, tempo: Tempo) -> None:
        self._membership = membership
        self._index = membership.config.index
        self._decisions = RealTimeDecisions(membership.config, tempo)
        self._processor, self._slowness = SlowProcessor(), 1.0
        self.transport = Transport(membership.run, membership.links, [], 1)
        timeout = PeerTimeout(ENVIRONMENT, membership.peer_timeout_s)
        self.transport.watch(timeout.see)
        timeout.expect()
        self._start = StartTime(self.transport)
        own = ("measured", "gone", "welcome")
        shares = (f"share/{j}" for j in membership.config.neighbours)
        topics = ["grant", "gone", *(f"{kind}/{self._index}" for kind in own), *shares]
        self._mailbox = Mailbox(self.transport, topics)

    def configured(self, config: NodeConfig) -> NodeConfig:
        """The configuration of a node whose groups end by the clock."""
        return dataclasses.replace(config, timed=True)

    def say_hello(self) -> None:
        """Tell the environment process that this node is ready."""
        self.transport.send(f"hello/{self._index}", self._membership.fingerprint.encode())

    def enter(self) -> tuple[NodeConfig, NodeState]:
        """Ask to be let in, and wait until the node is, where the network runs already."""
        begun = await_links(self.transport, self._membership.peers)
        self._start.compare_clocks()
        self.say_hello()
        self._decisions.asked(time.monotonic())
        config = self.configured(self._membership.config)
        if not begun:
            return config, state_machine.initial_state(config)
        welcome = self._await_welcome()
        config, state = self._decisions.begin_late(config, welcome, time.monotonic())
        return self.configured(config), state

    def _await_welcome(self) -> Welcome:
        while True:
            welcome = self._decisions.welcome_in(*self._mailbox.get(), time.monotonic())
            if welcome is not None:
                return welcome
            self._ask_if_due()

    def _ask_if_due(self) -> None:
        if self._decisions.has_to_ask:
            self._decisions.asked(time.monotonic())
            self.say_hello()

    def begin(self) -> None:
        """Wait for the common start, which a node that has skipped ahead knows."""
        timetable = self._decisions.timetable
        timetable.start_s = timetable.start_s or self._start.wait()

    def next_events(self, config: NodeConfig, state: NodeState) -> Sequence[NodeEvent]:
        """Wait for a message, or until the time of the heartbeat or the open group is over.

        Raises:
            GivenUp: the node is far behind, and has to enter again.
        """
        slow = config.faults.at("slow-cpu", state.step, self._index)
        self._slowness = slow[0] if slow else 1.0
        self._processor.work(self._slowness)
        if self._decisions.has_to_enter(state, time.monotonic()):
            self._skip_ahead()
        try:
            message = self._next_message(config, state)
        except Empty:
            return self._decisions.pass_deadline(config, state, self._mailbox.waiting())
        events = self._decisions.take(state, *message, time.monotonic())
        self._ask_if_due()
        return events

    def _next_message(self, config: NodeConfig, state: NodeState) -> tuple[str, bytes]:
        """Return the next message.

        Raises:
            Empty: none came in time.
        """
        until_s = self._decisions.wait_until_s(config, state)
        if until_s == UNTIL_A_MESSAGE:
            return self._mailbox.get()
        left_s = until_s - time.monotonic()
        if left_s <= 0 and self._decisions.takes_what_waits(state):
            return self._mailbox.get_waiting()
        return self._mailbox.get_within(left_s)

    def _skip_ahead(self) -> None:
        """Leave out the steps up to now, with all messages that wait.

        Raises:
            GivenUp: always.
        """
        self._decisions.skip_ahead()
        self._mailbox.clear()
        raise GivenUp

    def settle(self, config: NodeConfig, state: NodeState) -> tuple[NodeConfig, NodeState]:
        """Count messages that could not be used, and apply a late welcome."""
        return self._decisions.settle(config, state)

    def send(self, state: NodeState, messages: Sequence[NodeMessage]) -> None:
        """Offer messages: a node that waits for a link that stands still misses its own times.

        Raises:
            GivenUp: the estimate is older than the timetable allows, and the node enters again.
        """
        self._processor.work(self._slowness)
        for message in messages:
            if isinstance(message, Estimate):
                self._send_estimate(state, message)
            else:
                self.transport.offer(topic(message), encode(message))

    def _send_estimate(self, state: NodeState, message: Estimate) -> None:
        timing, estimate = self._decisions.dated(message, time.monotonic())
        # Before the estimate: with the last estimate the recorder has all.
        self.transport.offer(topic(timing), encode(timing))
        if estimate is not None:
            self.transport.offer(topic(estimate), encode(estimate))
        elif state.phase is not Phase.FINISHED:
            self._skip_ahead()

    def await_joined(self, state: NodeState) -> None:
        """The clock waits for no node."""

    def link(self, config: NodeConfig) -> None:
        """The graph stays: settings cannot change where the clock waits for no node."""

    def note(self, config: NodeConfig, before: NodeState, after: NodeState) -> None:
        """Record when a cycle begins: when its share has been sent."""
        self._decisions.note(config, before, after, time.monotonic())

    def leave(self) -> None:
        """Wait until the recorder has kept everything, and leave the network."""
        self._mailbox.ended.wait()
        self.transport.close()
