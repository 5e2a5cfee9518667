"""What the process of a node does in real time: the same state machine, driven by the clock.

Each node keeps a timetable (`nodes/tempo.py`) from a common start that the world announces. A part
of a cycle ends at its time, with whatever has come; nobody waits for a neighbour, and no share
waits for a receiver that is slow. A node that hears nothing of the world goes on without readings,
and asks to be let in again when it is told that it was given up. What the timetable cost is said
step by step (`Timing`).
"""

import dataclasses
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from queue import Empty, Full, Queue

import msgspec

from nodes import node_changes, state_machine
from nodes.changes import Change, Gone, Welcome
from nodes.clock import WorldClock, ahead_s
from nodes.entry import await_links
from nodes.links import RECORDER, WORLD
from nodes.membership import Membership
from nodes.messages import (
    END,
    CycleClosed,
    Estimate,
    MalformedMessage,
    Measured,
    NodeEvent,
    NodeMessage,
    ShareHeard,
    Timing,
    decode,
    encode,
    topic,
)
from nodes.node_state import Phase, count
from nodes.patience import Patience
from nodes.share import cycle_of
from nodes.tempo import Tempo
from nodes.zenoh_transport import Transport

_MAILBOX = 65_536
# Whoever asks to be let in again does not ask twice in this time.
_ASK_AGAIN_S = 1.0


def run_node_in_real_time(membership: Membership, tempo: Tempo) -> None:
    """Be one node until the recorder says that the run is over.

    Raises:
        LinkError: the network cannot be joined.
    """
    player, name = _Player(membership, tempo), str(membership.config.index)
    transport = player.transport
    if membership.patience_s is not None:
        transport.watch(Patience(WORLD, membership.patience_s).see)
    if membership.late:
        transport.join(name, {WORLD, RECORDER})
        begun = await_links(transport, membership.peers)
        player.compare_clocks()
    else:
        transport.join(name, {WORLD, RECORDER, *map(str, membership.peers)})
        begun = False
    transport.send(f"hello/{name}", membership.fingerprint.encode())
    if begun:
        player.enter()
    player.play()
    player.ended.wait()
    transport.close()


@dataclasses.dataclass
class _Record:
    """How well a step keeps its time, while it lasts."""

    heartbeat_late_s: float | None
    cycle_late_s: list[float] = dataclasses.field(default_factory=list)
    incomplete: int = 0
    overrun: int = 0


class _Player:
    """A node's place in a network that keeps time."""

    def __init__(self, membership: Membership, tempo: Tempo) -> None:
        config = dataclasses.replace(membership.config, timed=True)
        self._config, self._tempo, self._fingerprint = config, tempo, membership.fingerprint
        self._state = state_machine.initial_state(config)
        self._start_s = self._ahead_s = 0.0
        self._mailbox: Queue[tuple[str, bytes]] = Queue(_MAILBOX)
        self._records: dict[int, _Record] = {}
        # The last cycle that lacked something: its parts count once.
        self._lacking = -1
        # What readings look like, and what has changed that no heartbeat has brought in time.
        self._last: Measured | None = None
        self._overdue: tuple[Change, ...] = ()
        self._alone = False
        self._asked_s = 0.0
        self._first_step = 0
        self._started, self.ended = threading.Event(), threading.Event()
        self.transport = Transport(membership.run, membership.links, [], 1)
        self.transport.listen("start", lambda name, data: self._started.set())
        self.transport.listen("end", self._hear_end)
        index = config.index
        own = [f"measured/{index}", "grant", "gone", f"gone/{index}", f"welcome/{index}"]
        for name in (*own, *(f"share/{j}" for j in config.neighbours)):
            self.transport.listen(name, self._hear)

    def _hear(self, name: str, data: bytes) -> None:
        """In zenoh's thread: what is too much is lost, as all else would have to wait behind it."""
        with suppress(Full):
            self._mailbox.put_nowait((name, data))

    def _hear_end(self, name: str, data: bytes) -> None:
        """In zenoh's thread."""
        if data == END:
            self.ended.set()
        else:
            self._hear(name, data)

    def enter(self) -> None:
        """Begin in a network that runs: wait to be let in, and with which belief."""
        welcome = None
        while welcome is None:
            name, data = self._mailbox.get()
            if name.startswith("welcome/"):
                welcome = _decoded(name, data)
        config, self._state = node_changes.begin_late(self._config, welcome)
        self._first_step = welcome.step
        self._config = dataclasses.replace(config, timed=True)
        # Until then we were told that we are out.
        self._asked_s = time.monotonic()

    def compare_clocks(self) -> None:
        """On another host the world's clock is another."""
        self._ahead_s = ahead_s(self._world_time)

    def play(self) -> None:
        """From the common start to the last step."""
        self._start_s = self._await_start() - self._ahead_s
        while self._state.phase is not Phase.FINISHED:
            if self._state.phase is Phase.MEASUREMENT:
                self._await_heartbeat()
            else:
                self._play_part()

    def _await_start(self) -> float:
        """When step 0 begins or began, on the world's clock."""
        while True:
            clock = self._ask_clock()
            if clock is not None and clock.start_s is not None:
                return clock.start_s
            # Who is there from the beginning on is told.
            self._started.wait()
            self._started.clear()

    def _ask_clock(self) -> WorldClock | None:
        answer = self.transport.ask("clock")
        return None if answer is None else msgspec.json.decode(answer, type=WorldClock)

    def _world_time(self) -> float | None:
        clock = self._ask_clock()
        return None if clock is None else clock.now_s

    def _await_heartbeat(self) -> None:
        """Wait for readings; go on without when the first cycle is over, or, once that was so, when
        half of its first part is, so that neighbours who hear nothing still hear each other."""
        step = self._state.step + 1
        groups = len(self._config.schedule.groups(self._state.cycle))
        wait_s = self._tempo.cycle_s / (2 * groups if self._alone else 1)
        deadline_s = self._start_s + self._tempo.step_begins_s(step) + wait_s
        while self._state.phase is Phase.MEASUREMENT:
            left_s = deadline_s - time.monotonic()
            try:
                if self._last is None:
                    # Nobody knows yet what readings look like here.
                    self._take(*self._mailbox.get())
                elif left_s > 0:
                    self._take(*self._mailbox.get(timeout=left_s))
                else:
                    self._take(*self._mailbox.get_nowait())
            except Empty:
                break
        self._alone = self._state.phase is Phase.MEASUREMENT
        if self._alone:
            self._go_without()

    def _go_without(self) -> None:
        """The step begins without readings, and with the control that was known last."""
        assert self._last is not None, "the first readings are waited for"
        step = self._state.step + 1
        blank = [[None] * len(reading) for reading in self._last.readings]
        self._records[step] = _Record(None)
        self._state = count(self._state, "missed readings")
        self._open(msgspec.structs.replace(self._last, step=step, readings=blank, changes=()))

    def _open(self, measured: Measured) -> None:
        changes = (*self._overdue, *measured.changes)
        self._overdue = ()
        self._step(msgspec.structs.replace(measured, changes=changes))

    def _play_part(self) -> None:
        """Hear until the time of the open part of the cycle is over, and end it."""
        deadline_s = self._start_s + self._deadline_s()
        while (left_s := deadline_s - time.monotonic()) > 0:
            try:
                self._take(*self._mailbox.get(timeout=left_s))
            except Empty:
                break
        # What is there already counts, and no more: who floods a node must not hold it up.
        for _ in range(self._mailbox.qsize()):
            self._take(*self._mailbox.get())
        self._close_part()

    def _deadline_s(self) -> float:
        config, state = self._config, self._state
        groups = len(config.schedule.groups(state.cycle))
        cycle = (state.cycle - config.first_cycle) % config.rounds
        return self._tempo.part_ends_s(state.step, cycle, state.group, groups)

    def _close_part(self) -> None:
        """The time is over: go on with what has come."""
        state, record = self._state, self._records[self._state.step]
        in_time = record.cycle_late_s[-1] < self._tempo.cycle_s
        lacks = not state_machine.is_complete(self._config, state)
        if in_time and lacks and self._lacking != state.cycle:
            self._lacking = state.cycle
            record.incomplete += 1
        self._step(CycleClosed(state.cycle, state.group))

    def _take(self, name: str, data: bytes) -> None:
        """Take what has come."""
        kind, _, owner = name.partition("/")
        enters = self._state.step < self._first_step
        if kind == "share" and enters and cycle_of(data) < self._state.cycle:
            # It was for those who took part then.
            return
        event = ShareHeard(int(owner), data) if kind == "share" else _decoded(name, data)
        match event:
            case None:
                self._state = count(self._state, "rejected message")
            case Gone(node) if node == self._config.index:
                if owner:
                    self._ask_to_be_let_in()
            case Welcome():
                self._config, self._state = node_changes.restore(self._config, self._state, event)
            case Measured(step=step) if step <= self._state.step:
                # Too late for its step; what has changed with it holds from now on.
                self._overdue += event.changes
                self._step(event)
            case Measured() if not state_machine.fits(self._state, event):
                self._step(event)
            case Measured(step=step):
                self._last = event
                if step not in self._records:
                    late_s = self._now_s() - self._tempo.step_begins_s(step)
                    self._records[step] = _Record(late_s)
                self._open(event)
            case _:
                self._step(event)

    def _ask_to_be_let_in(self) -> None:
        """The others have given this node up, which has gone on by itself."""
        now_s = time.monotonic()
        if now_s - self._asked_s > _ASK_AGAIN_S:
            self._asked_s = now_s
            self.transport.send(f"hello/{self._config.index}", self._fingerprint.encode())

    def _step(self, event: NodeEvent) -> None:
        before = self._state.cycle, self._state.step
        self._state, messages = state_machine.step(self._config, self._state, event)
        # A cycle begins when its share is ready to go.
        self._send(messages)
        if self._state.phase is Phase.CHANGE:
            changed = node_changes.apply(self._config, self._state)
            self._config, self._state, messages = changed
            self._send(messages)
        state = self._state
        is_open = state.phase in (Phase.GRANT, Phase.SHARES)
        if is_open and (state.cycle, state.step) != before:
            self._note_beginning()

    def _note_beginning(self) -> None:
        config, state = self._config, self._state
        cycle = (state.cycle - config.first_cycle) % config.rounds
        late_s = self._now_s() - self._tempo.cycle_begins_s(state.step, cycle)
        record = self._records[state.step]
        record.cycle_late_s.append(late_s)
        record.overrun += late_s >= self._tempo.cycle_s

    def _send(self, messages: Sequence[NodeMessage]) -> None:
        # Offered, as whoever waits for a link that stands still misses his own times.
        for message in messages:
            if isinstance(message, Estimate):
                # Before it: with the last estimate the recorder has all.
                timing = self._timing(message.step)
                self.transport.offer(topic(timing), encode(timing))
            self.transport.offer(topic(message), encode(message))

    def _timing(self, step: int) -> Timing:
        record = self._records.pop(step)
        return Timing(
            self._config.index,
            step,
            record.heartbeat_late_s,
            record.cycle_late_s,
            record.incomplete,
            record.overrun,
            self._now_s() - self._tempo.step_begins_s(step),
        )

    def _now_s(self) -> float:
        return time.monotonic() - self._start_s


def _decoded(name: str, data: bytes):
    """A message, or None where the bytes are none."""
    try:
        return decode(name, data)
    except MalformedMessage:
        return None
