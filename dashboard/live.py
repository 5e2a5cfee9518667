"""A network that runs: heard without holding it up, commanded through what it answers to.

Hearing costs: each message is some microseconds of a processor that the network needs. So the page
listens all the time only to networks that say less than `_MESSAGES_PER_S`; of a faster one it hears
a few whole steps, rests, and hears a few more.
"""

import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from dashboard.assembler import Assembler
from dashboard.frame import Frame
from dashboard.network import Network
from dashboard.source import Answer, Pace
from dashboard.stage import Stage, restaged, set_stage
from nodes.links import Links
from nodes.zenoh_transport import LinkError, Transport
from scenarios.setup import Setup

_MESSAGES_PER_S = 2500.0
_STATE_PERIOD_S = 0.5
_FRAMES_PER_LISTENING = 2
_ANSWER_S = 5.0
_QUEUE = 20_000


class Situation(msgspec.Struct):
    """What a network answers to `state` (docs/control.md)."""

    run: str
    setup: Setup
    members: list[int]
    completed: int = 0
    paused: bool = False
    steps_per_second: float = 0.0
    settings: dict[str, Any] = {}
    cut: list[tuple[int, int]] = []
    losses: list[tuple[int, int, float]] = []
    loss: float = 0.0


class _Pause(msgspec.Struct):
    completed: int = 0
    paused: bool = False


class _Answered(msgspec.Struct):
    accepted: bool
    detail: str = ""


class NotThere(ValueError):
    """No network answers where the user says."""


class LiveNetwork:
    """A source of frames and a taker of commands; `endpoints` are all those of the network.

    Raises:
        NotThere: nobody answers, or something else than a network of this version.
    """

    live = True

    def __init__(self, endpoints: Sequence[str], run: str | None) -> None:
        situation = _situation(endpoints, run)
        self._transport = _joined(endpoints, situation.run)
        settings = dict(situation.settings)
        stage = set_stage(situation.setup)
        self._stage = restaged(stage, settings) if settings else stage
        self._heard: deque[tuple[str, bytes]] = deque(maxlen=_QUEUE)
        self._count = 0
        self._state = _Pause(situation.completed, situation.paused)
        self._assembler = Assembler(self._stage, network_of(situation))
        self._ended = False
        self._asked_s = time.monotonic()
        self._listening_since_s = self._asked_s
        self._rest_until_s = 0.0
        self._frames_heard = 0
        self._stop_hearing = self._transport.listen("watch/**", self._hear)

    @property
    def stage(self) -> Stage:
        """The stage with the settings of the newest frame."""
        return self._assembler.stage

    def _hear(self, topic: str, data: bytes) -> None:
        """In zenoh's thread: keep it; a queue that is full loses the oldest."""
        self._count += 1
        self._heard.append((topic.partition("/")[2], data))

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
                self._assembler.begin_anew()
                self._count, self._frames_heard = 0, 0
                self._listening_since_s = now_s
                self._stop_hearing = self._transport.listen("watch/**", self._hear)
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
        self._asked_s = now_s
        answer = self._transport.ask("state", seconds=0.3)
        if answer is None:
            self._ended = not self._heard
            return
        self._state = msgspec.json.decode(answer, type=_Pause)

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
        told = self._transport.ask("control", msgspec.json.encode(command), seconds=_ANSWER_S)
        if told is None:
            return Answer(False, "the network does not answer; has it ended?")
        try:
            answer = msgspec.json.decode(told, type=_Answered)
        except msgspec.MsgspecError as error:
            return Answer(False, f"the network answered what cannot be understood: {error}")
        if answer.accepted and command["do"] in ("pause", "resume"):
            self._state = _Pause(self._state.completed, command["do"] == "pause")
        return Answer(answer.accepted, answer.detail)

    def close(self) -> None:
        """Leave; the network does not notice."""
        self._transport.close()


def network_of(situation: Situation) -> Network:
    """What is known of a network when one begins to listen."""
    rounds = int(situation.settings.get("rounds", situation.setup.scenario.rounds))
    # Where the count of cycles began anew is not told: then the shares show it.
    first = -1 if "rounds" in situation.settings else 0
    return Network(
        members=frozenset(situation.members),
        anchor=(0, first, rounds),
        cut=frozenset(map(tuple, situation.cut)),
        losses={(sender, receiver): chance for sender, receiver, chance in situation.losses},
        loss=situation.loss,
        settings=situation.settings,
        paused=situation.paused,
    )


def _joined(endpoints: Sequence[str], run: str) -> Transport:
    try:
        return Transport(run, Links("peer", (), tuple(endpoints)), [], 1)
    except LinkError as error:
        raise NotThere(f"--connect: {error}") from None


def _situation(endpoints: Sequence[str], run: str | None) -> Situation:
    """The answer of the network; of the only one there if its name is not given."""
    asker = _joined(endpoints, run or "*")
    try:
        answer = asker.ask("state", seconds=_ANSWER_S)
    finally:
        asker.close()
    where = ", ".join(endpoints)
    if answer is None:
        name = f"the run {run}" if run else "a run"
        raise NotThere(
            f"--connect {where}: {name} does not answer there; network.json in the folder of a "
            "run that is still running names its endpoints"
        )
    try:
        return msgspec.json.decode(answer, type=Situation)
    except msgspec.MsgspecError as error:
        raise NotThere(f"--connect {where}: no network of this version answers ({error})") from None
