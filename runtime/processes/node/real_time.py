"""Real time at a node: it goes on when the clock says so, with whatever has come.

Each node keeps a timetable (`nodes/tempo.py`) from a common start that the environment process
announces. A group of a cycle ends at its time; no node waits for a neighbour, and no share waits
for a receiver that is slow. A node that hears no heartbeat goes on without readings. A node that is
told that it was given up asks to be let in again. A `Timing` tells of each
step what the timetable cost.
"""

import dataclasses
import time
from collections.abc import Sequence
from contextlib import suppress
from queue import Empty

from msgspec.structs import replace

from concord.nodes import node as state_machine
from concord.nodes import node_changes
from concord.nodes.changes import Gone, Welcome
from concord.nodes.messages import (
    CycleClosed,
    Estimate,
    MalformedMessage,
    Measured,
    NodeEvent,
    NodeMessage,
    ShareHeard,
    decode,
    encode,
    topic,
)
from concord.nodes.node_state import NodeConfig, NodeState, Phase, count
from concord.nodes.tempo import Tempo
from concord.runtime.network.links import ENVIRONMENT
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.node.entry import await_links
from concord.runtime.processes.node.heartbeats import Heartbeats
from concord.runtime.processes.node.mailbox import Mailbox
from concord.runtime.processes.node.membership import Membership
from concord.runtime.processes.node.process import GivenUp
from concord.runtime.processes.node.slow_processor import SlowProcessor
from concord.runtime.processes.node.start_time import StartTime
from concord.runtime.processes.node.timetable import NodeTimetable
from concord.runtime.processes.node.timing_records import TimingRecords
from concord.runtime.processes.peer_timeout import PeerTimeout

# A node that asks to be let in again does not ask twice in this time; one that waits for the answer
# asks again only where the link has lost it.
_ASK_AGAIN_S, _ANSWER_S = 1.0, 5.0
_SKIPPED = "skipped ahead"


class RealTimeNode:
    """Paces a node by the clock: what does not come in time is missed."""

    def __init__(self, membership: Membership, tempo: Tempo) -> None:
        self._membership, self._timetable = membership, NodeTimetable(tempo)
        self._index = membership.config.index
        self._heartbeats = Heartbeats()
        self._records = TimingRecords(tempo.cycle_s)
        # Messages that came before the deadline and are still to be taken, once it is over.
        self._is_over, self._in_time = False, 0
        self._counted: list[str] = []
        self._late_welcomes: list[Welcome] = []
        self._asked_s, self._skips = 0.0, 0
        self._processor, self._slowness = SlowProcessor(), 1.0
        self._first_step = 0
        self._cycle_of = membership.config.bus.frame_format.cycle_of
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
        self._asked_s = time.monotonic()
        config = self.configured(self._membership.config)
        if not begun:
            return config, state_machine.initial_state(config)
        welcome = self._await_welcome()
        config, state = node_changes.begin_late(config, welcome)
        self._first_step = welcome.step
        # The totals of a life begin anew, but for this one.
        self._counted += [_SKIPPED] * self._skips
        # Up to now the environment process said that this node is out.
        self._asked_s = time.monotonic()
        return self.configured(config), state

    def _await_welcome(self) -> Welcome:
        while True:
            name, data = self._mailbox.get()
            if name == f"gone/{self._index}":
                self._ask_to_be_let_in(_ANSWER_S)
            if name.startswith("welcome/"):
                with suppress(MalformedMessage):
                    return decode(name, data)

    def begin(self) -> None:
        """Wait for the common start, which a node that has skipped ahead knows."""
        self._timetable.start_s = self._timetable.start_s or self._start.wait()

    def next_events(self, config: NodeConfig, state: NodeState) -> Sequence[NodeEvent]:
        """Wait for a message, or until the time of the heartbeat or the open group is over.

        Raises:
            GivenUp: the node is far behind, and has to enter again.
        """
        slow = config.faults.at("slow-cpu", state.step, self._index)
        self._slowness = slow[0] if slow else 1.0
        self._processor.work(self._slowness)
        if self._timetable.is_far_behind(state.step + 1):
            self._skip_ahead()
        if state.phase is Phase.MEASUREMENT:
            return self._await_heartbeat(config, state)
        if not self._is_over:
            with suppress(Empty):
                left_s = self._timetable.left_s(config, state)
                return self._take(state, *self._mailbox.get_within(left_s))
            # Messages that are there already count, and no more: a flood must not hold a node up.
            self._is_over, self._in_time = True, self._mailbox.waiting()
        if self._in_time:
            self._in_time -= 1
            return self._take(state, *self._mailbox.get())
        self._is_over = False
        complete = state_machine.is_complete(config, state)
        self._records.end_group(state.step, state.cycle, complete)
        return (CycleClosed(state.cycle, state.group),)

    def _skip_ahead(self) -> None:
        """Leave out the steps up to now, with all messages that wait.

        Raises:
            GivenUp: always.
        """
        self._skips += 1
        self._mailbox.clear()
        self._heartbeats, self._records = Heartbeats(), TimingRecords(self._timetable.tempo.cycle_s)
        self._is_over, self._in_time = False, 0
        raise GivenUp

    def _await_heartbeat(self, config: NodeConfig, state: NodeState) -> Sequence[NodeEvent]:
        """Wait for readings until the first cycle is over.

        A node that had none in the step before waits for half of the first group, so that
        neighbours that hear no environment process still hear each other.
        """
        if not self._heartbeats.are_known:
            return self._take(state, *self._mailbox.get())
        groups = len(config.schedule.groups(state.cycle))
        is_alone = self._heartbeats.was_blank(state.step)
        wait_s = self._timetable.tempo.cycle_s / (2 * groups if is_alone else 1)
        step = state.step + 1
        left_s = wait_s - self._timetable.late_s(step)
        try:
            late = left_s <= 0
            came = self._mailbox.get_waiting() if late else self._mailbox.get_within(left_s)
        except Empty:
            return self._go_without(step)
        return self._take(state, *came)

    def _go_without(self, step: int) -> Sequence[NodeEvent]:
        self._records.hear_heartbeat(step, None)
        self._counted.append("missed readings")
        return (self._heartbeats.blank(step),)

    def _take(self, state: NodeState, name: str, data: bytes) -> Sequence[NodeEvent]:
        """Return the events that a message means to the node now."""
        kind, _, owner = name.partition("/")
        if kind == "share":
            if state.step < self._first_step and self._cycle_of(data) < state.cycle:
                # It was for the nodes that took part then.
                return ()
            return (ShareHeard(int(owner), data),)
        try:
            event = decode(name, data)
        except MalformedMessage:
            self._counted.append("rejected message")
            return ()
        match event:
            case Gone(node) if node == self._index:
                if owner:
                    self._ask_to_be_let_in()
                return ()
            case Welcome():
                self._late_welcomes.append(event)
                return ()
            case Measured():
                return self._take_measured(state, event)
        return (event,)

    def _take_measured(self, state: NodeState, event: Measured) -> Sequence[NodeEvent]:
        if event.step <= state.step:
            self._heartbeats.miss(event)
            return (event,)
        if not state_machine.fits(state, event):
            return (event,)
        self._records.hear_heartbeat(event.step, self._timetable.late_s(event.step))
        return (self._heartbeats.opening(event),)

    def _ask_to_be_let_in(self, again_s: float = _ASK_AGAIN_S) -> None:
        """The others have given this node up, which has gone on by itself."""
        now_s = time.monotonic()
        if now_s - self._asked_s > again_s:
            self._asked_s = now_s
            self.say_hello()

    def settle(self, config: NodeConfig, state: NodeState) -> tuple[NodeConfig, NodeState]:
        """Count messages that could not be used, and apply a late welcome."""
        if self._counted:
            state = count(state, *self._counted)
            self._counted.clear()
        while self._late_welcomes:
            config, state = node_changes.restore(config, state, self._late_welcomes.pop(0))
        return config, state

    def send(self, state: NodeState, messages: Sequence[NodeMessage]) -> None:
        """Offer messages: a node that waits for a link that stands still misses its own times.

        Raises:
            GivenUp: the estimate is older than the timetable allows, and the node enters again.
        """
        self._processor.work(self._slowness)
        for message in messages:
            dated = self._dated(state, message) if isinstance(message, Estimate) else message
            if dated is not None:
                self.transport.offer(topic(dated), encode(dated))

    def _dated(self, state: NodeState, estimate: Estimate) -> Estimate | None:
        """Return an estimate with its age, and send its timing; None for one that is too old.

        Raises:
            GivenUp: it is too old, and the run goes on.
        """
        age_s = self._timetable.late_s(estimate.step)
        # Before the estimate: with the last estimate the recorder has all.
        timing = self._records.take(self._index, estimate.step)
        self.transport.offer(topic(timing), encode(timing))
        if age_s <= self._timetable.tempo.oldest_s:
            return replace(estimate, age_s=age_s)
        if state.phase is not Phase.FINISHED:
            self._skip_ahead()
        return None

    def await_joined(self, state: NodeState) -> None:
        """The clock waits for no node."""

    def note(self, config: NodeConfig, before: NodeState, after: NodeState) -> None:
        """Record when a cycle begins: when its share has been sent."""
        is_open = after.phase in (Phase.GRANT, Phase.SHARES)
        if is_open and (after.cycle, after.step) != (before.cycle, before.step):
            cycle = (after.cycle - config.first_cycle) % config.rounds
            self._records.begin_cycle(after.step, self._timetable.late_s(after.step, cycle))

    def leave(self) -> None:
        """Wait until the recorder has kept everything, and leave the network."""
        self._mailbox.ended.wait()
        self.transport.close()
