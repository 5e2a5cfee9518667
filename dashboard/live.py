"""A network that runs: heard without holding it up, commanded through what it answers to.

Hearing costs: each message is some microseconds of a processor that the network needs. So the page
listens all the time only to networks that say less than `_MESSAGES_PER_S`; of a faster one it hears
a few whole steps, rests, and hears a few more.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from threading import Thread
from typing import Any

import msgspec

from dashboard.assembler import Assembler
from dashboard.frame import Frame
from dashboard.network import Network
from dashboard.source import Answer, Pace
from dashboard.stage import Stage, restaged, set_stage
from nodes.commands import Command
from nodes.control_client import Client, NotThere
from scenarios.setup import Setup

_MESSAGES_PER_S = 1500.0
_STATE_PERIOD_S = 0.5
_FRAMES_PER_LISTENING = 2
_QUEUE = 20_000
_TOPICS = ("truth", "measured/*", "share/*", "estimate/*")


class Standing(msgspec.Struct):
    """What changes have made of a network so far."""

    settings: dict[str, Any] = {}
    loss: float | None = None
    losses: list[tuple[int, int, float]] = []
    cuts: list[tuple[int, int]] = []
    first_step: int = 0
    first_cycle: int = 0


class Situation(msgspec.Struct):
    """What a network answers to `state` (docs/control.md)."""

    run: str
    setup: Setup
    members: list[int]
    standing: Standing
    completed: int = 0
    paused: bool = False


class _Pause(msgspec.Struct):
    completed: int = 0
    paused: bool = False


class LiveNetwork:
    """A source of frames and a taker of commands; `endpoints` are all those of the network, `keys`
    a file of `concord keys` for one that is guarded.

    Raises:
        ValueError: nobody answers, or something else than a network of this version.
    """

    live = True

    def __init__(self, endpoints: Sequence[str], run: str | None, keys: str | None = None) -> None:
        self._client = Client(endpoints, run, keys)
        try:
            situation = msgspec.convert(self._client.state(), Situation)
        except msgspec.ValidationError as error:
            self._client.close()
            raise ValueError(f"--connect: no network of this version answers ({error})") from None
        settings = dict(situation.standing.settings)
        stage = set_stage(situation.setup)
        self._stage = restaged(stage, settings) if settings else stage
        self._heard: deque[tuple[str, bytes]] = deque(maxlen=_QUEUE)
        self._count = 0
        self._state = _Pause(situation.completed, situation.paused)
        self._begun_and_done = 0
        self._assembler = Assembler(self._stage, network_of(situation))
        self._ended = self._closed = False
        self._asked_s = time.monotonic()
        self._listening_since_s = self._asked_s
        self._rest_until_s = 0.0
        self._frames_heard = 0
        self._client.listen("event", self._hear)
        self._stop_hearing: Callable[[], None] | None = self._listen()

    @property
    def stage(self) -> Stage:
        """The stage with the settings of the newest frame."""
        return self._assembler.stage

    def _listen(self) -> Callable[[], None]:
        """Begin to hear what is drawn, and no more; returns what ends it."""
        stops = [self._client.listen(topic, self._hear) for topic in _TOPICS]

        def stop() -> None:
            for one in stops:
                one()

        return stop

    def _hear(self, topic: str, data: bytes) -> None:
        """In zenoh's thread: keep it; a queue that is full loses the oldest."""
        self._count += 1
        self._heard.append((topic, data))

    def poll(self) -> list[Frame]:
        """The frames that have come since the last call."""
        self._ask_state()
        frames: list[Frame] = []
        while self._heard:
            frames += self._assembler.take(*self._heard.popleft())
        self._frames_heard += len(frames)
        self._rest_or_listen(time.monotonic())
        return frames

    def _rest_or_listen(self, now_s: float) -> None:
        """Keep what is heard below so many messages per second."""
        if self._stop_hearing is None:
            if now_s >= self._rest_until_s:
                state = self._state
                self._assembler.begin_anew(state.completed if state.paused else None)
                self._count, self._frames_heard = 0, 0
                self._listening_since_s = now_s
                self._stop_hearing = self._listen()
            return
        listened_s = now_s - self._listening_since_s
        too_much = self._count > _MESSAGES_PER_S * max(listened_s, 0.2)
        if too_much and self._frames_heard >= _FRAMES_PER_LISTENING:
            self._stop_hearing()
            self._stop_hearing = None
            self._rest_until_s = self._listening_since_s + self._count / _MESSAGES_PER_S
        elif listened_s > 1.0 and not too_much:
            self._count, self._listening_since_s = 0, now_s

    def _ask_state(self) -> None:
        now_s = time.monotonic()
        if self._ended or now_s - self._asked_s < _STATE_PERIOD_S:
            return
        self._asked_s = float("inf")
        # In a thread of its own: whoever draws does not wait for an answer.
        Thread(target=self._hear_state, daemon=True).start()

    def _hear_state(self) -> None:
        before = self._begun_and_done
        try:
            state = msgspec.convert(self._client.state(), _Pause)
            # What was said before a command and is heard after it is no longer so.
            if self._begun_and_done == before:
                self._state = state
        except NotThere:
            self._ended = True
        except Exception:
            # Whoever leaves does not wait for an answer that nobody needs.
            if not self._closed:
                raise
        finally:
            self._asked_s = time.monotonic()

    def pace(self) -> Pace:
        """Whether the network runs, and how far it is."""
        if self._ended:
            return Pace("ENDED", "nobody answers any more")
        steps = self._assembler.stage.setup.scenario.steps
        told = f"{self._state.completed} of {steps} steps"
        if self._state.completed >= steps:
            return Pace("ENDED", told)
        return Pace("PAUSED" if self._state.paused else "RUNNING", told)

    def ask(self, command: Mapping[str, Any]) -> Answer:
        """Command the network; waits for its answer."""
        self._begun_and_done += 1
        try:
            answer = self._client.command(msgspec.convert(command, Command))
        except msgspec.ValidationError as error:
            return Answer(False, f"{command['do']}: {error}")
        except NotThere as gone:
            self._ended = True
            return Answer(False, str(gone))
        if answer.accepted and command["do"] in ("pause", "resume"):
            self._state = _Pause(self._state.completed, command["do"] == "pause")
        self._begun_and_done += 1
        return Answer(answer.accepted, answer.detail)

    def close(self) -> None:
        """Leave; the network does not notice."""
        self._closed = True
        self._client.close()


def network_of(situation: Situation) -> Network:
    """What is known of a network when one begins to listen."""
    standing = situation.standing
    rounds = int(standing.settings.get("rounds", situation.setup.scenario.rounds))
    return Network(
        members=frozenset(situation.members),
        anchor=(standing.first_step, standing.first_cycle, rounds),
        cut=frozenset((sender, receiver) for sender, receiver in standing.cuts),
        losses={(sender, receiver): chance for sender, receiver, chance in standing.losses},
        loss=standing.loss or 0.0,
        settings=standing.settings,
        paused=situation.paused,
    )
