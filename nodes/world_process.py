"""What the world's process does: it drives the conductor with what nodes say, with who comes and
goes, and with what people ask for."""

import dataclasses
import re
import sys
import threading
import time
from collections.abc import Sequence
from functools import partial
from queue import Empty, SimpleQueue

import msgspec

from nodes import world
from nodes.bounds import node_of
from nodes.changes import Gone, Welcome
from nodes.clock import WorldClock
from nodes.command_checks import check_timely
from nodes.commands import Answer, Kill, Restart, Speed, read_command
from nodes.conductor import Conductor, Scripted, Stage
from nodes.failures import Deserted, compare
from nodes.links import RECORDER, WORLD, Links
from nodes.management import Management
from nodes.messages import (
    END,
    BidsClosed,
    MalformedMessage,
    Start,
    StepClosed,
    Unreachable,
    WorldMessage,
    decode,
    encode,
    topic,
)
from nodes.metronome import Metronome, tell_on_time
from nodes.notices import Asked, Hello, Notice, Presence, Recorded, Repeated
from nodes.overflow import Overflow
from nodes.patience import Patience
from nodes.said import AGAIN, Said
from nodes.tempo import Tempo
from nodes.world import WorldConfig
from nodes.world_timetable import Beat, timetable
from nodes.world_words import in_words, last_words, standing, waits_for
from nodes.zenoh_transport import Transport

WORLD_QUEUE = 8192
_ANSWER_S = 5.0
# A run that nobody records ends after so long; on several hosts its link may come back any time.
_PATIENCE_S = 60.0
# Some steps more than others may be behind.
_KEPT = 16_384
# How often the world says for whom it waits.
_TELL_S = 10.0
_FINGERPRINT = re.compile(rb"[0-9a-f]{64}")
_NOT_OURS = "nodes run on hosts of their own; end and start `concord node` there"
# From the announcement of the common start to the start: every node must have heard it.
_HEAD_START_S = 0.2


def run_world(
    run: str,
    links: Links,
    config: WorldConfig,
    fingerprint: str,
    management: Management,
    script: Sequence[Scripted] = (),
    tempo: Tempo | None = None,
) -> None:
    """Be the world: wait for all nodes, then run to the last step; `on_step(0)` means ready.

    With a `tempo` steps begin when their time has come, whoever has estimated the last one.

    Raises:
        LinkError: the network cannot be joined.
        Disagreement: a node's configuration is not ours.
        Deserted: no node is left.
    """
    _Office(run, links, config, fingerprint, management, script, tempo).work()


class _Office:
    """The world's place in the network of processes."""

    def __init__(
        self,
        run: str,
        links: Links,
        config: WorldConfig,
        fingerprint: str,
        management: Management,
        script: Sequence[Scripted],
        tempo: Tempo | None,
    ) -> None:
        self._run, self._nodes, self._fingerprint = run, config.nodes, fingerprint
        self._management, self._tempo = management, tempo
        self._doomed: set[int] = set()
        self._begun = False
        # One for each message that was none.
        self._refused: list[None] = []
        stage = Stage(self._doomed.add, self._start, management.check)
        if tempo is not None:
            config = dataclasses.replace(config, lead=config.steps)
        self._conductor = Conductor(config, script, stage, tempo is not None)
        self._start_s: float | None = None
        self._patience = Patience(RECORDER, _PATIENCE_S) if management.keeps_nodes else None
        self._notices: SimpleQueue[Notice] = SimpleQueue()
        self._source = "estimate/*"
        self._ended = threading.Event()
        self._metronome = Metronome(lambda: self._notify(Beat()))
        topics = ["bid/*", "estimate/*"]
        self._transport = Transport(run, links, topics, WORLD_QUEUE, answers=True)
        self._queues = Overflow(self._transport, topics, WORLD_QUEUE)
        self._transport.listen("end", self._hear_end)
        self._transport.listen("hello/*", self._hear_hello)
        self._transport.listen("recorded/*", self._hear_recorded)
        self._transport.listen("unreachable/*", self._hear_unreachable)
        for kind in ("bid", "estimate", "hello"):
            self._transport.listen(f"{AGAIN}/{kind}/*", self._hear_again)
        said = partial(Said, self._transport, "the world", "truth", _KEPT, self._waiting)
        self._said = said(self._gone if tempo is None else list)
        self._transport.answer("state", self._state)
        self._transport.answer("clock", self._clock)
        self._transport.answer("control", self._ask)

    def work(self) -> None:
        """From the first hello to the end."""
        nodes = [str(node) for node in range(self._nodes)]
        self._transport.join(WORLD, ())
        self._await_all([RECORDER, *nodes])
        self._transport.watch(self._hear_of_presence)
        for name in self._transport.missing([RECORDER, *nodes]):
            # Who was gone again before we watched.
            self._hear_of_presence(name, False)
        self._await_hellos()
        self._said.begin()
        self._begun = True
        self._management.on_step(0)
        conductor, completed = self._conductor, 0
        self._queues.out = False
        self._send(conductor.begin() if self._tempo is None else self._announce(self._tempo))
        while not conductor.finished:
            for message in self._next_messages():
                self._take(*message)
            if conductor.state.completed > completed:
                completed = conductor.state.completed
                self._management.on_step(completed)
        self._metronome.set(0)
        self._said.say("finished", last_words(conductor.config, conductor.state))
        self._queues.out = True
        self._ended.wait()
        self._queues.close()
        self._said.close()
        self._transport.close()

    def _announce(self, tempo: Tempo) -> list[WorldMessage]:
        """In real time: from a common start on, a step at each beat."""
        start = Start(time.monotonic() + _HEAD_START_S)
        self._start_s = start.at_s
        tell_on_time(start.at_s, timetable(tempo, self._conductor.config), self._notify)
        self._transport.send(topic(start), encode(start))
        return self._conductor.command(Speed(1 / tempo.step_s))

    def _await_all(self, names: Sequence[str]) -> None:
        """Wait for everybody, and say for whom."""
        while not self._transport.await_present(names, _TELL_S):
            missing = self._transport.missing(names)
            sys.stderr.write(f"the world waits for {in_words(missing)}\n")

    def _await_hellos(self) -> None:
        missing = set(range(self._nodes))
        while missing:
            match self._notices.get():
                case Hello() as hello:
                    compare(hello, self._fingerprint)
                    missing.discard(hello.node)
                case Presence(node, False):
                    # Its next life has to say hello again.
                    missing.add(node)
                case Asked(_, answer):
                    answer.put(Answer(False, "the run has not begun; try again"))

    def _next_messages(self) -> list[tuple[str, bytes]]:
        """What nodes say; nothing after there was something else to do."""
        conductor = self._conductor
        bids = world.awaits_bids(conductor.config, conductor.state)
        # Set before we look for notices: who gives one wakes up whom we then wait for.
        self._source = "bid/*" if bids else "estimate/*"
        if self._notices.empty():
            return self._queues.receive((self._source,)) or self._queues.take()
        notice = self._notices.get()
        if isinstance(notice, Repeated):
            # What has come before changes nothing, and is no mistake.
            self._send(conductor.take(notice.event))
        else:
            self._attend(notice)
        return []

    def _take(self, name: str, data: bytes) -> None:
        try:
            event = decode(name, data)
        except MalformedMessage as error:
            self._refuse(str(error))
            return
        before = self._conductor.state
        self._send(self._conductor.take(event))
        if self._conductor.state is before:
            # Of nobody who takes part, of no open step, or of no contest: late, or never to be.
            self._refused.append(None)

    def _take_waiting(self, source: str) -> None:
        """What is there already has come in time, however late the world looks."""
        messages = self._queues.take()
        # No more than all can have said at once, however much comes.
        for _ in range(self._nodes):
            received = self._transport.receive_at_once(source)
            if received is None:
                break
            messages.append(received)
        for message in messages:
            self._take(*message)

    def _attend(self, notice: Notice) -> None:
        conductor = self._conductor
        match notice:
            case Presence(node, is_there):
                self._see(node, is_there)
            case Hello(node, fingerprint):
                self._greet(node, fingerprint)
            case Recorded(node):
                if node in self._doomed:
                    self._doomed.discard(node)
                    self._management.kill(node)
                else:
                    self._refuse(f"node {node} was not to leave")
            case Asked():
                notice.answer.put(self._obey(notice.payload))
            case Beat():
                self._send(conductor.tick())
                self._remind()
            case BidsClosed() | StepClosed():
                self._take_waiting("bid/*" if isinstance(notice, BidsClosed) else "estimate/*")
                self._send(conductor.take(notice))
            case Unreachable(node, neighbour):
                # Frames between them are lost. One of them is out until there is a link again.
                absent = conductor.state.standing.absent
                if node not in absent and neighbour not in absent:
                    self._give_up(neighbour)

    def _greet(self, node: int, fingerprint: str) -> None:
        if fingerprint != self._fingerprint:
            # One that comes late with something else is not let in, and ends nothing.
            self._refuse(f"node {node} comes with another setup; refused")
        elif node not in self._doomed:
            # A killed node asks until its process ends. A member's process was started again.
            if node not in self._conductor.state.standing.absent:
                self._send(self._conductor.take(Gone(node)))
            self._send(self._conductor.ready(node))

    def _see(self, node: int, is_there: bool) -> None:
        if not is_there:
            self._conductor.lost(node)
            self._give_up(node)
        elif node in self._conductor.state.standing.absent:
            # A node that was given up may have been out of reach only: it must know.
            self._transport.send(f"gone/{node}", encode(Gone(node)))

    def _give_up(self, node: int) -> None:
        self._send(self._conductor.take(Gone(node)))
        if not self._conductor.deserted:
            return
        if self._management.keeps_nodes:
            raise Deserted("no node is left")
        # On several hosts the world may be the one that is cut off: it stands still till they are
        # back, and the step that was open ends with what has come.
        if self._tempo is None:
            self._send(self._conductor.take(StepClosed(self._conductor.state.released - 1)))

    def _remind(self) -> None:
        """In real time: who is there again and was given up must know."""
        if self._tempo is None:
            return
        absent = [str(node) for node in self._conductor.state.standing.absent]
        for node in set(absent) - set(self._transport.missing(absent)):
            self._transport.offer(f"gone/{node}", encode(Gone(int(node))))

    def _obey(self, payload: bytes) -> Answer:
        try:
            command = read_command(payload)
            if self._tempo is not None:
                check_timely(command)
            if isinstance(command, Kill | Restart) and not self._management.keeps_nodes:
                return Answer(False, _NOT_OURS)
            self._send(self._conductor.command(command))
        except ValueError as refused:
            return Answer(False, str(refused))
        if self._tempo is None:
            self._metronome.set(self._conductor.steps_per_second)
        return Answer(True)

    def _start(self, node: int) -> bool:
        self._doomed.discard(node)
        self._management.start(node)
        return False

    def _send(self, messages: Sequence[WorldMessage]) -> None:
        for message in messages:
            # A link that stands still must not hold up who keeps time.
            say = self._said.say
            if self._tempo is not None:
                waits = isinstance(message, Welcome)
                say = self._transport.send if waits else self._transport.offer
            say(topic(message), encode(message))

    def _refuse(self, why: str) -> None:
        """Count what is no message; the first is shown, as a flood would hide all else."""
        if not self._refused:
            sys.stderr.write(f"world: {why}\n")
        self._refused.append(None)

    # --- in zenoh's threads ----------------------------------------------------------------------

    def _notify(self, notice: Notice) -> None:
        self._notices.put(notice)
        if not self._conductor.finished:
            self._transport.wake(self._source)

    def _hear_again(self, name: str, data: bytes) -> None:
        said = name.partition("/")[2]
        if said.startswith("hello/"):
            # Later it would be that of a node's next life.
            return None if self._begun else self._hear_hello(said, data)
        try:
            self._notify(Repeated(decode(said, data)))
        except MalformedMessage as error:
            self._refuse(str(error))

    def _waiting(self) -> str:
        conductor = self._conductor
        return waits_for(conductor.config, conductor.state, timed=self._tempo is not None)

    def _gone(self) -> list[tuple[str, bytes]]:
        """Who was told of a return after the end of who came back waits for it."""
        return [("gone", encode(Gone(i))) for i in self._conductor.state.standing.absent]

    def _hear_end(self, _name: str, data: bytes) -> None:
        # Nobody has kept everything before everything was said.
        if data == END and self._conductor.finished:
            self._ended.set()
        else:
            self._refuse(f"topic 'end' carried {data[:60]!r} before the end")

    def _hear_of_presence(self, name: str, is_there: bool) -> None:
        self._said.see(name, is_there)
        if self._patience is not None:
            self._patience.see(name, is_there)
        node = node_of(name, self._nodes)
        if node is not None:
            self._notify(Presence(node, is_there))

    def _hear_hello(self, name: str, data: bytes) -> None:
        node = node_of(name.partition("/")[2], self._nodes)
        if node is not None and _FINGERPRINT.fullmatch(data):
            self._notify(Hello(node, data.decode()))
        else:
            self._refuse(f"topic {name[:60]!r} carried {data[:60]!r}: no digest of a setup")

    def _hear_recorded(self, name: str, _data: bytes) -> None:
        node = node_of(name.partition("/")[2], self._nodes)
        if node is None:
            self._refuse(f"topic {name[:60]!r} is of no node")
        else:
            self._notify(Recorded(node))

    def _hear_unreachable(self, name: str, data: bytes) -> None:
        try:
            lost: Unreachable = decode(name, data)
        except MalformedMessage as error:
            self._refuse(str(error))
            return
        if max(lost.node, lost.neighbour) < self._nodes:
            self._notify(lost)
        else:
            self._refuse(f"topic {name!r} speaks of no node")

    def _ask(self, payload: bytes) -> bytes:
        answer: SimpleQueue[Answer] = SimpleQueue()
        self._notify(Asked(payload, answer))
        try:
            return msgspec.json.encode(answer.get(timeout=_ANSWER_S))
        except Empty:
            return msgspec.json.encode(Answer(False, "the world does not answer; try again"))

    def _clock(self, _payload: bytes) -> bytes:
        return msgspec.json.encode(WorldClock(time.monotonic(), self._start_s))

    def _state(self, _payload: bytes) -> bytes:
        setup, refused = self._management.setup, len(self._refused)
        return standing(self._run, setup, self._conductor, begun=self._begun, refused=refused)
