"""What the process of a node does in real time: the same state machine, driven by the clock.

Each node keeps a timetable (`nodes/tempo.py`) from a common start that the world announces. A part
of a cycle ends at its time, with whatever has come; nobody waits for a neighbour, and no share
waits for a receiver that is slow. What the timetable cost is said step by step (`Timing`).
"""

import dataclasses
import time
from collections.abc import Collection, Sequence
from queue import Empty, Queue

from nodes import state_machine
from nodes.changes import Gone
from nodes.links import RECORDER, WORLD, Links
from nodes.messages import (
    CycleClosed,
    Estimate,
    MalformedMessage,
    Measured,
    NodeEvent,
    NodeMessage,
    ShareHeard,
    ShareSent,
    Start,
    Timing,
    decode,
    encode,
    topic,
)
from nodes.node_state import NodeConfig, Phase, count
from nodes.tempo import Tempo
from nodes.zenoh_transport import Transport

_QUEUE, _MAILBOX = 16, 65_536


def run_node_in_real_time(
    run: str,
    links: Links,
    config: NodeConfig,
    peers: Collection[int],
    fingerprint: str,
    tempo: Tempo,
) -> None:
    """Be one node until the recorder says that the run is over.

    `peers` are those whom it hears or who hear it: all must be there before the first share.

    Raises:
        LinkError: the network cannot be joined.
    """
    player = _Player(run, links, dataclasses.replace(config, timed=True), tempo)
    player.transport.join(str(config.index), {WORLD, RECORDER, *map(str, peers)})
    player.transport.send(f"hello/{config.index}", fingerprint.encode())
    player.play()
    while player.transport.receive("end") is None:
        pass
    player.transport.close()


@dataclasses.dataclass
class _Record:
    """How well a step keeps its time, while it lasts."""

    heartbeat_late_s: float
    cycle_late_s: list[float] = dataclasses.field(default_factory=list)
    incomplete: int = 0
    overrun: int = 0


class _Player:
    """A node's place in a network that keeps time."""

    def __init__(self, run: str, links: Links, config: NodeConfig, tempo: Tempo) -> None:
        self._config, self._tempo = config, tempo
        self._state = state_machine.initial_state(config)
        self._start_s = 0.0
        self._mailbox: Queue[tuple[str, bytes]] = Queue(_MAILBOX)
        self._records: dict[int, _Record] = {}
        # The last cycle that lacked something: its parts count once.
        self._lacking = -1
        self.transport = Transport(run, links, ["start", "end"], _QUEUE)
        own = [f"measured/{config.index}", "grant", "gone", f"gone/{config.index}"]
        for name in (*own, *(f"share/{j}" for j in config.neighbours)):
            self.transport.listen(name, lambda name, data: self._mailbox.put((name, data)))

    def play(self) -> None:
        """From the common start to the last step, or until the others have given this node up."""
        self._start_s = self._await_start()
        while self._state.phase is not Phase.FINISHED:
            if self._state.phase is Phase.MEASUREMENT:
                on = self._take(*self._mailbox.get())
            else:
                on = self._play_part()
            if not on:
                return

    def _await_start(self) -> float:
        while True:
            received = self.transport.receive("start")
            if received is not None:
                start: Start = decode(*received)
                return start.at_s

    def _play_part(self) -> bool:
        """Hear until the time of the open part of the cycle is over, and end it."""
        deadline_s = self._start_s + self._deadline_s()
        while (left_s := deadline_s - time.monotonic()) > 0:
            try:
                if not self._take(*self._mailbox.get(timeout=left_s)):
                    return False
            except Empty:
                break
        # What is there already counts, and no more: who floods a node must not hold it up.
        for _ in range(self._mailbox.qsize()):
            if not self._take(*self._mailbox.get()):
                return False
        self._close_part()
        return True

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

    def _take(self, name: str, data: bytes) -> bool:
        """Take what has come; False if it says that this node was given up."""
        kind, _, owner = name.partition("/")
        try:
            event = ShareHeard(int(owner), data) if kind == "share" else decode(name, data)
        except MalformedMessage:
            self._state = count(self._state, "rejected message")
            return True
        match event:
            case Gone(node) if node == self._config.index:
                return False
            case Measured(step=step) if step not in self._records and step > self._state.step:
                self._records[step] = _Record(self._now_s() - self._tempo.step_begins_s(step))
        self._step(event)
        return True

    def _step(self, event: NodeEvent) -> None:
        before = self._state.cycle, self._state.step
        self._state, messages = state_machine.step(self._config, self._state, event)
        # A cycle begins when its share is ready to go.
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
        for message in messages:
            if isinstance(message, ShareSent):
                self.transport.offer(topic(message), encode(message))
                continue
            if isinstance(message, Estimate):
                # Before it: with the last estimate the recorder has all.
                timing = self._timing(message.step)
                self.transport.send(topic(timing), encode(timing))
            self.transport.send(topic(message), encode(message))

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
