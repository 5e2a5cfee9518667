"""Running network: received without slowing it, commanded through its control interface.

Each received message costs processor time that the network needs. So the page receives whole steps:
the recorder offers every step of a slow network and some steps of a fast one
(`runtime/processes/recorder/throttled_feed.py`).
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from threading import Thread
from typing import Any

import msgspec

from concord.dashboard.frames.assembler import Assembler
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.network import NetworkStatus
from concord.dashboard.frames.source import CommandAnswer, SourceState
from concord.dashboard.frames.stage import Stage, restaged, set_stage
from concord.nodes.commands import Command
from concord.runtime.network.control_client import Client, NotThere
from concord.runtime.processes.recorder.throttled_feed import STEPS_PER_S
from concord.runtime.whole_steps import WholeStep
from concord.scenarios.setup import Setup

_STATE_PERIOD_S = 0.5
# The network is asked twice a second; a loaded machine may answer a few times later.
_SILENT_S = 5.0
_QUEUE = 1000
_MOST_ASKS = 5
# The page draws ten times a second meanwhile.
_TAKE_OVER_S = 0.03


class LiveStanding(msgspec.Struct):
    """State of a network after its changes so far."""

    settings: dict[str, Any] = {}
    loss: float | None = None
    losses: list[tuple[int, int, float]] = []
    cuts: list[tuple[int, int]] = []
    first_step: int = 0
    first_cycle: int = 0


class LiveSituation(msgspec.Struct):
    """Answer of a network to `state` (docs/control.md)."""

    run: str
    setup: Setup
    members: list[int]
    standing: LiveStanding
    completed: int = 0
    paused: bool = False
    steps_per_second: float = 0.0


class _Pause(msgspec.Struct):
    completed: int = 0
    paused: bool = False
    steps_per_second: float = 0.0


class _HeardEvents:
    """The events that a page has, each as often as it came; `ask()` returns all of the run."""

    def __init__(self, ask: Callable[[], Sequence[bytes]], hear: Callable[[bytes], None]) -> None:
        self._ask, self._hear = ask, hear
        self._known: Counter[bytes] = Counter()
        self._asks = 0

    def begin(self, events: Sequence[bytes]) -> None:
        """Begin with the events before the page."""
        self._known = Counter(events)

    def take(self, event: bytes) -> None:
        """Hear an event."""
        self._known[event] += 1
        self._hear(event)

    def are_here(self, events: int) -> bool:
        """Ask for events that a full link has dropped, where there have been so many; say whether
        they are here, or were asked for in vain `_MOST_ASKS` times."""
        if events <= self._known.total():
            return True
        known = self._known.copy()
        for event in self._ask():
            if known[event]:
                known[event] -= 1
            else:
                self.take(event)
        self._asks = (self._asks + 1) % _MOST_ASKS
        return events <= self._known.total() or not self._asks


class LiveNetwork:
    """A source of frames and a taker of commands; `endpoints` are all those of the network, `keys`
    a file of `concord keys` for one that is guarded. It refuses commands if it is `read_only`.

    Raises:
        ValueError: no network of this version answers.
    """

    live = True

    def __init__(
        self,
        endpoints: Sequence[str],
        run: str | None,
        keys: str | None = None,
        read_only: bool = False,
    ) -> None:
        self.takes_commands = not read_only
        self._client = Client(endpoints, run, keys)
        self._heard: deque[tuple[str, bytes]] = deque(maxlen=_QUEUE)
        # First: what is said while the network answers must not be missed.
        for topic in ("event", "steps"):
            self._client.listen(topic, self._hear)
        try:
            situation = msgspec.convert(self._client.state(), LiveSituation)
        except msgspec.ValidationError as error:
            self._client.close()
            raise ValueError(f"--connect: no network of this version answers ({error})") from None
        standing, stage = situation.standing, set_stage(situation.setup)
        since = standing.first_step, standing.first_cycle
        settings = self._settings = dict(standing.settings)
        self._stage = restaged(stage, settings, *since) if settings else stage
        self._state = _Pause(situation.completed, situation.paused, situation.steps_per_second)
        self._completed = situation.completed
        self._begun_and_done = 0
        self._assembler = Assembler(self._stage, network_of(situation))
        self._events = _HeardEvents(lambda: self._client.events(), self._assembler.hear)
        self._taking_over: Iterator[int] = iter(())
        self._taken: int | None = None
        self._take_over(standing.first_step)
        self._end: str | None = None
        self._refused = self._closed = False
        self._asked_s = self._heard_s = time.monotonic()

    @property
    def stage(self) -> Stage:
        """Return the stage with the settings of the newest frame."""
        return self._assembler.stage

    def _hear(self, topic: str, data: bytes) -> None:
        """In zenoh's thread: keep it; a queue that is full loses the oldest."""
        self._heard_s = time.monotonic()
        self._heard.append((topic, data))

    def _take_over(self, since: int) -> None:
        """Begin with the newest whole step, unless it had other settings than those since a step.

        The filter that hears everything follows a network whose steps all come. It first takes the
        readings of the steps before.
        """
        with suppress(msgspec.MsgspecError):
            handed = self._client.handover()
            if handed is None or handed.step.number < since:
                return
            self._know(handed.events)
            self._heard.appendleft(("steps", msgspec.msgpack.encode(handed.step)))
            before = (handed.readings or [])[:-1]
            is_whole = [step.number for step in before] == list(range(handed.step.number))
            is_slow = self._state.paused or 0 < self._state.steps_per_second <= STEPS_PER_S
            # Readings do not say where their sensors stood before they moved.
            has_moved = "placement" in self._settings
            if is_whole and is_slow and not has_moved:
                self._taking_over = self._assembler.filters.centralised.take_over(before)

    def _is_taking_over(self) -> bool:
        """Go on with the steps before the first frame for a moment; say whether some are left."""
        if len(self._heard) > _QUEUE // 2:
            # The network is faster than the filter.
            self._taking_over = iter(())
        until_s = time.monotonic() + _TAKE_OVER_S
        for step in self._taking_over:
            self._taken = step
            if time.monotonic() > until_s:
                return True
        self._taken = None
        return False

    def poll(self) -> list[StepFrame]:
        """Return the frames that have come since the last call."""
        self._ask_state()
        if self._is_taking_over():
            return []
        frames: list[StepFrame | None] = []
        while self._heard:
            topic, data = self._heard.popleft()
            if topic == "event":
                self._events.take(data)
                continue
            with suppress(msgspec.MsgspecError):
                step = msgspec.msgpack.decode(data, type=WholeStep)
                if not self._events.are_here(step.events):
                    # Without its events the step would be drawn with the links of before.
                    self._heard.appendleft((topic, data))
                    break
                frames.append(self._assembler.frame(step))
                self._completed = max(self._completed, step.number + 1)
        return [frame for frame in frames if frame is not None]

    def _know(self, events: Sequence[bytes]) -> None:
        """Begin with the events before the page: the state of the network has them already."""
        before = set(events)
        for message in list(self._heard):
            if message[0] == "event" and message[1] in before:
                self._heard.remove(message)
        self._events.begin(events)

    def _ask_state(self) -> None:
        now_s = time.monotonic()
        if self._end is not None or now_s - self._asked_s < _STATE_PERIOD_S:
            return
        self._asked_s = float("inf")
        # The request has its own thread, so the drawing loop does not wait for the answer.
        Thread(target=self._hear_state, daemon=True).start()

    def _hear_state(self) -> None:
        before = self._begun_and_done
        try:
            state = msgspec.convert(self._client.state(), _Pause)
            # A message that was sent before a command and arrives after it is out of date.
            if self._begun_and_done == before:
                self._state = state
            self._heard_s, self._refused = time.monotonic(), False
        except NotThere:
            # Asked again: a network that was stopped, or a link that broke, may come back.
            self._refused = True
        except Exception:
            # A page that closes need not wait for the answer.
            if not self._closed:
                raise
        finally:
            self._asked_s = time.monotonic()

    def pace(self) -> SourceState:
        """Return whether the network runs, and how far it is."""
        steps = self._assembler.stage.setup.scenario.steps
        completed, rate = max(self._state.completed, self._completed), self._state.steps_per_second
        told = f"{completed} of {steps} steps"
        if self._end is not None:
            return SourceState("ENDED", f"{told}; {self._end}")
        if completed >= steps:
            return SourceState("ENDED", told)
        silent_s = time.monotonic() - self._heard_s
        if self._refused or silent_s > _SILENT_S:
            return SourceState("SILENT", f"no answer for {silent_s:.0f} s, after {told}")
        if self._taken is not None:
            told = f"readings of {self._taken + 1} of {completed} steps"
            return SourceState("LOADING", told, completed, rate)
        if self._state.paused:
            return SourceState("PAUSED", told, completed, rate, tuple(self._assembler.pending))
        return SourceState("RUNNING", told, completed, rate)

    def ask(self, command: Mapping[str, Any]) -> CommandAnswer:
        """Command the network; waits for its answer."""
        if not self.takes_commands:
            return CommandAnswer(False, f"{command['do']}: this page is read-only")
        self._begun_and_done += 1
        try:
            answer = self._client.command(msgspec.convert(command, Command))
        except msgspec.ValidationError as error:
            return CommandAnswer(False, f"{command['do']}: {error}")
        except NotThere as gone:
            self._refused = True
            return CommandAnswer(False, str(gone))
        if answer.accepted and command["do"] in ("pause", "resume"):
            self._state = msgspec.structs.replace(self._state, paused=command["do"] == "pause")
        if answer.accepted and command["do"] == "speed":
            rate = float(command["steps_per_second"])
            self._state = msgspec.structs.replace(self._state, steps_per_second=rate)
        self._begun_and_done += 1
        return CommandAnswer(answer.accepted, answer.detail)

    def end(self, words: str) -> None:
        """Show from now on that the run is over; `words` say where its results are."""
        self._end = words

    def close(self) -> None:
        """Leave; the network does not notice."""
        self._closed = True
        self._client.close()


def network_of(situation: LiveSituation) -> NetworkStatus:
    """Return the network as known when the page begins to receive."""
    standing = situation.standing
    rounds = int(standing.settings.get("rounds", situation.setup.scenario.rounds))
    return NetworkStatus(
        members=frozenset(situation.members),
        anchor=(standing.first_step, standing.first_cycle, rounds),
        cut=frozenset((sender, receiver) for sender, receiver in standing.cuts),
        losses={(sender, receiver): chance for sender, receiver, chance in standing.losses},
        loss=standing.loss or 0.0,
        settings=standing.settings,
        paused=situation.paused,
    )
