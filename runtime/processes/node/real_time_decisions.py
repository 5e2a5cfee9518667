"""Decisions of a node in real time: functions of its state, a message or none, and the time.

Nothing here waits, sends or reads a clock. The process of a node (`real_time.py`) does so, and
simulation testing under a virtual clock.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from msgspec.structs import replace

from concord.nodes import node as state_machine
from concord.nodes import node_changes
from concord.nodes.changes import Change, Gone, Welcome
from concord.nodes.messages import (
    CycleClosed,
    Estimate,
    MalformedMessage,
    Measured,
    NodeEvent,
    ShareHeard,
    Timing,
    decode,
)
from concord.nodes.node_state import NodeConfig, NodeState, Phase, count
from concord.nodes.tempo import Tempo


@dataclass
class _Record:
    """One step that is under way, or will be."""

    heartbeat_late_s: float | None
    cycle_late_s: list[float] = field(default_factory=list)
    incomplete: int = 0
    overrun: int = 0


class TimingRecords:
    """Collects the delays of each step until its estimate is sent."""

    def __init__(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._steps: dict[int, _Record] = {}
        # The last cycle that lacked something: its groups count once.
        self._lacking = -1

    def hear_heartbeat(self, step: int, late_s: float | None) -> None:
        """The first heartbeat of a step came so late; None: the node goes on without one."""
        self._steps.setdefault(step, _Record(late_s))

    def begin_cycle(self, step: int, late_s: float) -> None:
        """A cycle of a step begins so long after its time."""
        record = self._steps[step]
        record.cycle_late_s.append(late_s)
        record.overrun += late_s >= self._cycle_s

    def end_group(self, step: int, cycle: int, is_complete: bool) -> None:
        """A group of a cycle ends at its deadline, with all that was due or without."""
        record = self._steps[step]
        in_time = record.cycle_late_s[-1] < self._cycle_s
        if in_time and not is_complete and self._lacking != cycle:
            self._lacking = cycle
            record.incomplete += 1

    def take(self, node: int, step: int) -> Timing:
        """Return the timing of a step that is over, and forget it."""
        record = self._steps.pop(step)
        return Timing(
            node,
            step,
            record.heartbeat_late_s,
            record.cycle_late_s,
            record.incomplete,
            record.overrun,
        )


class NodeTimetable:
    """Times of steps and groups on the node's own clock, which shows `now_s`.

    `start_s` is the common start on that clock, 0 until it is known.
    """

    def __init__(self, tempo: Tempo) -> None:
        self.tempo, self.start_s = tempo, 0.0

    def late_s(self, now_s: float, step: int, cycle: int = 0) -> float:
        """Return how long ago a cycle of a step began; `cycle` counts from 0 in each step."""
        return now_s - self.start_s - self.tempo.cycle_begins_s(step, cycle)

    def group_ends_s(self, config: NodeConfig, state: NodeState) -> float:
        """Return the time at which the open group of the cycle ends."""
        groups = len(config.schedule.groups(state.cycle))
        cycle = (state.cycle - config.first_cycle) % config.rounds
        return self.start_s + self.tempo.group_ends_s(state.step, cycle, state.group, groups)

    def is_lost(self, now_s: float, step: int) -> bool:
        """Whether an estimate of a step that is sent now counts as lost."""
        return self.late_s(now_s, step) > self.tempo.oldest_s


class Heartbeats:
    """Remembers what readings look like, and changes that no heartbeat has brought in time."""

    def __init__(self) -> None:
        self._pattern: tuple[Measured, ...] = ()
        self._overdue: tuple[Change, ...] = ()
        self._blank_step = -1

    @property
    def are_known(self) -> bool:
        """Whether a heartbeat has shown what readings look like here."""
        return bool(self._pattern)

    def was_blank(self, step: int) -> bool:
        """Whether the node has begun this step without a heartbeat."""
        return step == self._blank_step

    def opening(self, measured: Measured) -> Measured:
        """A heartbeat that is in time, with the changes that are overdue."""
        self._pattern = (measured,)
        changes, self._overdue = (*self._overdue, *measured.changes), ()
        return replace(measured, changes=changes)

    def miss(self, measured: Measured) -> None:
        """A heartbeat came too late for its step; its changes hold from now on."""
        self._overdue += measured.changes

    def blank(self, step: int) -> Measured:
        """The heartbeat of a step without readings, with the control that was known last."""
        self._blank_step = step
        (last,) = self._pattern
        readings = [[None] * len(reading) for reading in last.readings]
        changes, self._overdue = self._overdue, ()
        return replace(last, step=step, readings=readings, changes=changes)


# A node that asks to be let in again does not ask twice in this time; one that waits for the answer
# asks again only where the link has lost it.
_ASK_AGAIN_S, _ANSWER_S = 1.0, 5.0
_SKIPPED = "skipped ahead"
AT_ONCE, UNTIL_A_MESSAGE = -math.inf, math.inf


class RealTimeDecisions:
    """When a node goes on, what a message means to it then, and whether it has to enter again.

    `now_s` is the time on the clock of the node's process. `has_to_ask` is true when the node has
    to say hello, until `asked`.
    """

    def __init__(self, config: NodeConfig, tempo: Tempo) -> None:
        self.timetable = NodeTimetable(tempo)
        self.has_to_ask = False
        self._index, self._cycle_of = config.index, config.bus.frame_format.cycle_of
        self._heartbeats = Heartbeats()
        self._records = TimingRecords(tempo.cycle_s)
        # Messages that came before the deadline and are still to be taken, once it is over.
        self._is_over, self._in_time = False, 0
        self._counted: list[str] = []
        self._late_welcomes: list[Welcome] = []
        self._asked_s, self._skips = 0.0, 0
        self._first_step = 0

    # --- entering the network ---------------------------------------------------------------------

    def asked(self, now_s: float) -> None:
        """The node has said hello."""
        self._asked_s, self.has_to_ask = now_s, False

    def welcome_in(self, name: str, data: bytes, now_s: float) -> Welcome | None:
        """Return the welcome that a node waits for, if a message is one."""
        if name == f"gone/{self._index}":
            self._ask_to_be_let_in(now_s, _ANSWER_S)
        if name.startswith("welcome/"):
            with suppress(MalformedMessage):
                return decode(name, data)
        return None

    def begin_late(
        self, config: NodeConfig, welcome: Welcome, now_s: float
    ) -> tuple[NodeConfig, NodeState]:
        """Return configuration and state of a node that is let in now."""
        config, state = node_changes.begin_late(config, welcome)
        self._first_step = welcome.step
        # The totals of a life begin anew, but for this one.
        self._counted += [_SKIPPED] * self._skips
        # Up to now the environment process said that this node is out.
        self._asked_s = now_s
        return config, state

    def has_to_enter(self, state: NodeState, now_s: float) -> bool:
        """Whether the estimate of a step that only begins would count as lost."""
        return self.timetable.is_lost(now_s, state.step + 1)

    def skip_ahead(self) -> None:
        """Forget the steps up to now: the node has to enter again."""
        self._skips += 1
        self._heartbeats = Heartbeats()
        self._records = TimingRecords(self.timetable.tempo.cycle_s)
        self._is_over, self._in_time = False, 0

    # --- taking part ------------------------------------------------------------------------------

    def wait_until_s(self, config: NodeConfig, state: NodeState) -> float:
        """Return when the node stops waiting for a message."""
        if state.phase is Phase.MEASUREMENT:
            return self._heartbeat_ends_s(config, state)
        if self._is_over:
            # Messages that were there at the deadline count, and no more: a flood must not hold a
            # node up.
            return UNTIL_A_MESSAGE if self._in_time else AT_ONCE
        return self.timetable.group_ends_s(config, state)

    def _heartbeat_ends_s(self, config: NodeConfig, state: NodeState) -> float:
        """Return the end of the first cycle of the step.

        A node that had no readings in the step before waits for half of the first group, so that
        neighbours that hear no environment process still hear each other.
        """
        if not self._heartbeats.are_known:
            return UNTIL_A_MESSAGE
        groups = len(config.schedule.groups(state.cycle))
        tempo, is_alone = self.timetable.tempo, self._heartbeats.was_blank(state.step)
        begins_s = self.timetable.start_s + tempo.step_begins_s(state.step + 1)
        return begins_s + tempo.cycle_s / (2 * groups if is_alone else 1)

    def takes_what_waits(self, state: NodeState) -> bool:
        """Whether a message that is there already is taken after the deadline: a late heartbeat."""
        return state.phase is Phase.MEASUREMENT

    def pass_deadline(
        self, config: NodeConfig, state: NodeState, waiting: int
    ) -> Sequence[NodeEvent]:
        """Go on without a message; `waiting` messages are there, which count as in time."""
        if state.phase is Phase.MEASUREMENT:
            self._records.hear_heartbeat(state.step + 1, None)
            self._counted.append("missed readings")
            return (self._heartbeats.blank(state.step + 1),)
        if not self._is_over and waiting:
            self._is_over, self._in_time = True, waiting
            return ()
        self._is_over = False
        complete = state_machine.is_complete(config, state)
        self._records.end_group(state.step, state.cycle, complete)
        return (CycleClosed(state.cycle, state.group),)

    def take(self, state: NodeState, name: str, data: bytes, now_s: float) -> Sequence[NodeEvent]:
        """Return the events that a message means to the node now."""
        if self._is_over and state.phase is not Phase.MEASUREMENT:
            self._in_time -= 1
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
                    self._ask_to_be_let_in(now_s)
                return ()
            case Welcome():
                self._late_welcomes.append(event)
                return ()
            case Measured():
                return self._take_measured(state, event, now_s)
        return (event,)

    def _take_measured(
        self, state: NodeState, event: Measured, now_s: float
    ) -> Sequence[NodeEvent]:
        if event.step <= state.step:
            self._heartbeats.miss(event)
            return (event,)
        if not state_machine.fits(state, event):
            return (event,)
        self._records.hear_heartbeat(event.step, self.timetable.late_s(now_s, event.step))
        return (self._heartbeats.opening(event),)

    def _ask_to_be_let_in(self, now_s: float, again_s: float = _ASK_AGAIN_S) -> None:
        """The others have given this node up, which has gone on by itself."""
        self.has_to_ask = self.has_to_ask or now_s - self._asked_s > again_s

    def settle(self, config: NodeConfig, state: NodeState) -> tuple[NodeConfig, NodeState]:
        """Count messages that could not be used, and apply a late welcome."""
        if self._counted:
            state = count(state, *self._counted)
            self._counted.clear()
        while self._late_welcomes:
            config, state = node_changes.restore(config, state, self._late_welcomes.pop(0))
        return config, state

    def dated(self, estimate: Estimate, now_s: float) -> tuple[Timing, Estimate | None]:
        """Return the timing of a step and its estimate with its age; None for one that is lost."""
        timing = self._records.take(self._index, estimate.step)
        if self.timetable.is_lost(now_s, estimate.step):
            return timing, None
        return timing, replace(estimate, age_s=self.timetable.late_s(now_s, estimate.step))

    def note(self, config: NodeConfig, before: NodeState, after: NodeState, now_s: float) -> None:
        """Record when a cycle begins: when its share has been sent."""
        is_open = after.phase in (Phase.GRANT, Phase.SHARES)
        if is_open and (after.cycle, after.step) != (before.cycle, before.step):
            cycle = (after.cycle - config.first_cycle) % config.rounds
            self._records.begin_cycle(after.step, self.timetable.late_s(now_s, after.step, cycle))
