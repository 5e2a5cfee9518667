"""What the world's process does: it drives the conductor with what nodes say, with who comes and
goes, and with what people ask for."""

import dataclasses
import sys
import time
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import NamedTuple

import msgspec

from nodes import world
from nodes.changes import Gone, Settings, Standing
from nodes.commands import Answer, Kill, Restart, Speed, read_command
from nodes.conductor import Conductor, Scripted, Stage
from nodes.links import RECORDER, WORLD, Links
from nodes.messages import (
    MalformedMessage,
    Start,
    Unreachable,
    WorldMessage,
    decode,
    encode,
    topic,
)
from nodes.metronome import Metronome, beat_on_time
from nodes.process import Finished
from nodes.tempo import Tempo
from nodes.world import WorldConfig
from nodes.zenoh_transport import Transport

WORLD_QUEUE = 16_384
_ANSWER_S = 5.0
# How often the world says for whom it waits.
_TELL_S = 10.0
_NOT_OURS = "nodes run on hosts of their own; end and start `concord node` there"
# From the announcement of the common start to the start: every node must have heard it.
_HEAD_START_S = 0.2


class Disagreement(Exception):
    """A node was started with another configuration than the world."""


class Deserted(Exception):
    """Every node is gone."""


class Presence(NamedTuple):
    """A process has come, or is gone."""

    name: str
    is_there: bool


class Hello(NamedTuple):
    """A node says that it is ready, and with which configuration."""

    node: int
    fingerprint: str


class Recorded(NamedTuple):
    """All that a node has said that leaves on command."""

    node: int


class Asked(NamedTuple):
    """Somebody has asked for something; the answer goes to a queue."""

    payload: bytes
    answer: SimpleQueue[Answer]


class Beat(NamedTuple):
    """At a limited speed: the time has come for a step."""


Notice = Presence | Hello | Recorded | Asked | Beat | Unreachable


class State(msgspec.Struct, frozen=True):
    """What the world answers to whoever asks how the network stands."""

    run: str
    setup: msgspec.Raw
    begun: bool
    completed: int
    released: int
    paused: bool
    steps_per_second: float
    members: list[int]
    standing: Standing


class Management(NamedTuple):
    """What the world needs beside the network: `kill(node)` and `start(node)` its process,
    `check(settings)` what people want to set, `on_step(completed)`; `setup` is JSON to be shown.
    Where it `keeps_nodes` it can kill and start them; others' processes are on other hosts."""

    kill: Callable[[int], None]
    start: Callable[[int], None]
    check: Callable[[Settings], Settings]
    on_step: Callable[[int], None]
    setup: bytes
    keeps_nodes: bool = True


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
        stage = Stage(self._doomed.add, self._start, management.check)
        if tempo is not None:
            config = dataclasses.replace(config, lead=config.steps)
        self._conductor = Conductor(config, script, stage)
        self._notices: SimpleQueue[Notice] = SimpleQueue()
        self._source = "estimate/*"
        self._metronome = Metronome(lambda: self._notify(Beat()))
        topics = ["bid/*", "estimate/*", "end"]
        self._transport = Transport(run, links, topics, WORLD_QUEUE, answers=True)
        self._transport.listen("hello/*", self._hear_hello)
        self._transport.listen("recorded/*", self._hear_recorded)
        self._transport.listen("unreachable/*", self._hear_unreachable)
        self._transport.answer("state", self._state)
        self._transport.answer("control", self._ask)

    def work(self) -> None:
        """From the first hello to the end."""
        nodes = [str(node) for node in range(self._nodes)]
        self._transport.join(WORLD, ())
        self._await_all([RECORDER, *nodes])
        self._transport.watch(lambda name, is_there: self._notify(Presence(name, is_there)))
        for node in nodes:
            # Who was gone again before we watched.
            if not self._transport.await_present({node}, 0):
                self._notify(Presence(node, False))
        self._await_hellos()
        self._begun = True
        self._management.on_step(0)
        conductor, completed = self._conductor, 0
        self._send(conductor.begin() if self._tempo is None else self._announce(self._tempo))
        while not conductor.finished:
            self._take(self._next_message())
            if conductor.state.completed > completed:
                completed = conductor.state.completed
                self._management.on_step(completed)
        self._metronome.set(0)
        members = world.members(conductor.config, conductor.state)
        finished = Finished(conductor.config.steps - 1, members)
        self._transport.send("finished", msgspec.json.encode(finished))
        while self._transport.receive("end") is None:
            pass
        self._transport.close()

    def _announce(self, tempo: Tempo) -> list[WorldMessage]:
        """In real time: from a common start on, a step at each beat."""
        start_s = time.monotonic() + _HEAD_START_S
        steps = self._conductor.config.steps
        beat_on_time(start_s, tempo.step_s, steps, lambda: self._notify(Beat()))
        start = Start(start_s)
        self._transport.send(topic(start), encode(start))
        return self._conductor.command(Speed(1 / tempo.step_s))

    def _await_all(self, names: Sequence[str]) -> None:
        """Wait for everybody, and say for whom."""
        while not self._transport.await_present(names, _TELL_S):
            missing = self._transport.missing(names)
            sys.stderr.write(f"the world waits for {', '.join(map(_in_words, missing))}\n")

    def _await_hellos(self) -> None:
        missing = set(range(self._nodes))
        while missing:
            match self._notices.get():
                case Hello() as hello:
                    self._compare(hello)
                    missing.discard(hello.node)
                case Presence(name, False) if name.isdecimal() and int(name) < self._nodes:
                    # Its next life has to say hello again.
                    missing.add(int(name))
                case Asked(_, answer):
                    answer.put(Answer(False, "the run has not begun; try again"))

    def _compare(self, hello: Hello) -> None:
        if hello.fingerprint != self._fingerprint:
            raise Disagreement(
                f"node {hello.node} runs configuration {hello.fingerprint[:12]!r}, the world "
                f"{self._fingerprint[:12]!r}; give all the same setup, version and kernels"
            )

    def _next_message(self) -> tuple[str, bytes] | None:
        """What a node says; None after there was something else to do."""
        conductor = self._conductor
        bids = world.awaits_bids(conductor.config, conductor.state)
        # Set before we look for notices: who gives one wakes up whom we then wait for.
        self._source = "bid/*" if bids else "estimate/*"
        try:
            self._attend(self._notices.get_nowait())
            return None
        except Empty:
            return self._transport.receive(self._source)

    def _take(self, message: tuple[str, bytes] | None) -> None:
        if message is None:
            return
        try:
            event = decode(*message)
        except MalformedMessage as error:
            sys.stderr.write(f"world: {error}\n")
            return
        self._send(self._conductor.take(event))

    def _attend(self, notice: Notice) -> None:
        """Somebody came, is gone, or wants something."""
        conductor = self._conductor
        match notice:
            case Presence(name, is_there) if name.isdecimal() and int(name) < self._nodes:
                self._see(int(name), is_there)
            case Hello(node, fingerprint) if fingerprint != self._fingerprint:
                # One that comes late with something else is not let in, and ends nothing.
                sys.stderr.write(f"world: node {node} comes with another setup; refused\n")
            case Hello():
                if notice.node not in conductor.state.standing.absent:
                    # It was started again before anybody had seen its end.
                    self._send(conductor.take(Gone(notice.node)))
                self._send(conductor.ready(notice.node))
            case Recorded(node) if node in self._doomed:
                self._doomed.discard(node)
                self._management.kill(node)
            case Asked():
                notice.answer.put(self._obey(notice.payload))
            case Beat():
                self._send(conductor.tick())
            case Unreachable(node, neighbour):
                # Frames between them are lost. One of them is out until there is a link again.
                absent = conductor.state.standing.absent
                if node not in absent and neighbour not in absent:
                    self._give_up(neighbour)

    def _see(self, node: int, is_there: bool) -> None:
        conductor = self._conductor
        absent = conductor.state.standing.absent
        if not is_there:
            conductor.lost(node)
            self._give_up(node)
        elif node in absent:
            # A node that was given up may have been out of reach only: it must know.
            self._transport.send(f"gone/{node}", encode(Gone(node)))

    def _give_up(self, node: int) -> None:
        self._send(self._conductor.take(Gone(node)))
        if self._conductor.deserted:
            raise Deserted("no node is left")

    def _obey(self, payload: bytes) -> Answer:
        if self._tempo is not None:
            return Answer(False, "a network in real time takes no commands; use --driver processes")
        try:
            command = read_command(payload)
            if isinstance(command, Kill | Restart) and not self._management.keeps_nodes:
                return Answer(False, _NOT_OURS)
            self._send(self._conductor.command(command))
        except ValueError as refused:
            return Answer(False, str(refused))
        self._metronome.set(self._conductor.steps_per_second)
        return Answer(True)

    def _start(self, node: int) -> bool:
        self._doomed.discard(node)
        self._management.start(node)
        return False

    def _send(self, messages: Sequence[WorldMessage]) -> None:
        for message in messages:
            self._transport.send(topic(message), encode(message))

    # --- in zenoh's threads ----------------------------------------------------------------------

    def _notify(self, notice: Notice) -> None:
        self._notices.put(notice)
        self._transport.wake(self._source)

    def _hear_hello(self, name: str, data: bytes) -> None:
        node = name.partition("/")[2]
        if node.isdecimal() and int(node) < self._nodes:
            self._notify(Hello(int(node), data.decode(errors="replace")))

    def _hear_recorded(self, name: str, _data: bytes) -> None:
        node = name.partition("/")[2]
        if node.isdecimal():
            self._notify(Recorded(int(node)))

    def _hear_unreachable(self, name: str, data: bytes) -> None:
        try:
            lost: Unreachable = decode(name, data)
        except MalformedMessage as error:
            sys.stderr.write(f"world: {error}\n")
            return
        if max(lost.node, lost.neighbour) < self._nodes:
            self._notify(lost)

    def _ask(self, payload: bytes) -> bytes:
        answer: SimpleQueue[Answer] = SimpleQueue()
        self._notify(Asked(payload, answer))
        try:
            return msgspec.json.encode(answer.get(timeout=_ANSWER_S))
        except Empty:
            return msgspec.json.encode(Answer(False, "the world does not answer; try again"))

    def _state(self, _payload: bytes) -> bytes:
        conductor = self._conductor
        state = conductor.state
        return msgspec.json.encode(
            State(
                self._run,
                msgspec.Raw(self._management.setup),
                self._begun,
                state.completed,
                state.released,
                conductor.paused,
                conductor.steps_per_second,
                world.members(conductor.config, state),
                state.standing,
            )
        )


def _in_words(name: str) -> str:
    return f"node {name}" if name.isdecimal() else f"the {name}"
