"""Where frames come from: a recording that is played, or a network that runs."""

import time
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from concord.dashboard.frames.assembler import Assembler
from concord.dashboard.frames.frame import LogEntry, StepFrame
from concord.dashboard.frames.stage import Stage
from concord.runtime.recording import read_recording
from concord.runtime.recording_file import is_closed
from concord.runtime.whole_steps import WholeStep, WholeSteps


def replayed(stage: Stage, recording: Path) -> Iterator[StepFrame]:
    """The frames of a recording, in order of steps.

    Raises:
        ValueError: the file is not a recording.
    """
    return assembled(stage, read_recording(recording))


def assembled(stage: Stage, messages: Iterable[tuple[str, bytes]]) -> Iterator[StepFrame]:
    """The frames that the (topic, bytes) of a run make, from its beginning on."""
    taker = FrameTaker(stage)
    for topic, data in messages:
        yield from taker.take(topic, data)
    yield from taker.rest()


class FrameTaker:
    """Takes the messages of a run one by one, and gives its frames in order."""

    def __init__(self, stage: Stage) -> None:
        self._assembler = Assembler(stage)
        self._steps = WholeSteps(stage.nodes, stage.rounds, stage.bus.frame_format)

    def take(self, topic: str, data: bytes) -> list[StepFrame]:
        """Take one message; return the frames of the steps that are over now."""
        if topic == "event":
            self._assembler.hear(data)
        return self._frames(self._steps.take(topic, data))

    def rest(self) -> list[StepFrame]:
        """Return the frames up to the last whole step; nothing more will come."""
        return self._frames(self._steps.rest())

    @property
    def torn_step(self) -> int | None:
        """Return the step within which the messages end, None where they end after one."""
        return self._steps.torn_step

    def _frames(self, steps: Iterable[WholeStep]) -> list[StepFrame]:
        frames = [self._assembler.frame(step) for step in steps]
        return [frame for frame in frames if frame is not None]


_FRAMES_PER_POLL = 40
# A recording without an end that was written to so lately may grow; the page looks once a second.
_GROWING_S, _LOOK_S = 10.0, 1.0


class CommandAnswer(NamedTuple):
    """Answer of a network to a command."""

    accepted: bool
    detail: str


class SourceState(NamedTuple):
    """State of a network: RUNNING, PAUSED, ENDED, or SILENT while it does not answer.

    A recording is LOADING or RECORDED. `detail` is for people. `completed` counts the steps of a
    network, and `steps_per_s` is the most that it does; 0 is as many as it can. `pending` are the
    changes that hold from the next step of a network that is paused.
    """

    state: str
    detail: str = ""
    completed: int = 0
    steps_per_s: float = 0.0
    pending: tuple[LogEntry, ...] = ()


class Source(Protocol):
    """Source of frames, which also passes commands to a running network."""

    @property
    def live(self) -> bool:
        """Return whether there is a network to command."""
        ...

    @property
    def takes_commands(self) -> bool:
        """Return whether the page may command the network."""
        ...

    @property
    def stage(self) -> Stage:
        """Return the stage as it is now: settings can change while a network runs."""
        ...

    def poll(self) -> list[StepFrame]:
        """Return the frames that have come since the last call; never waits."""
        ...

    def pace(self) -> SourceState:
        """Return whether the network runs."""
        ...

    def ask(self, command: dict[str, Any]) -> CommandAnswer:
        """Command the network; waits for its answer."""
        ...

    def close(self) -> None:
        """Leave."""
        ...


class RecordedSource:
    """A recording: read little by little, so that the page is there at once.

    A recording that is still written is followed. `verdict` is that of the whole run, in words;
    empty where there is none.
    """

    live = takes_commands = False

    def __init__(self, stage: Stage, recording: Path, verdict: str = "") -> None:
        self.stage = stage
        self._verdict = verdict and f"; the whole run: {verdict}"
        self._recording, self._taker = recording, FrameTaker(stage)
        self._size_bytes = recording.stat().st_size
        self._messages: Iterator[tuple[str, bytes]] = read_recording(recording)
        self._taken = self._read = 0
        self._is_read = self._has_rested = self._grows = False
        self._look_s = 0.0

    def poll(self) -> list[StepFrame]:
        """Return the next few frames of the recording.

        Raises:
            ValueError: the file is not a recording.
        """
        frames: list[StepFrame] = []
        while not self._is_read and len(frames) < _FRAMES_PER_POLL:
            message = next(self._messages, None)
            if message is not None:
                self._taken += 1
                frames += self._taker.take(*message)
            elif time.monotonic() < self._look_s or not self._reads_on():
                break
        if self._is_read and not self._has_rested:
            self._has_rested = True
            frames += self._taker.rest()
        self._read += len(frames)
        return frames

    def _reads_on(self) -> bool:
        """Look for what was written meanwhile; say whether there is more."""
        self._look_s = time.monotonic() + _LOOK_S
        status = self._recording.stat()
        if status.st_size != self._size_bytes:
            self._size_bytes = status.st_size
            self._messages = islice(read_recording(self._recording), self._taken, None)
            return True
        is_young = time.time() - status.st_mtime < _GROWING_S
        self._grows = is_young and not is_closed(self._recording)
        self._is_read = not self._grows
        return False

    def pace(self) -> SourceState:
        """A recording has no pace of its own; the player sets it."""
        if self._is_read:
            torn = self._taker.torn_step
            ends = "" if torn is None else f"; the recording ends within step {torn}"
            return SourceState("RECORDED", f"{self._read} steps{ends}{self._verdict}")
        if self._grows:
            return SourceState("LOADING", f"{self._read} steps so far; the recording grows")
        steps = self.stage.setup.scenario.steps
        return SourceState("LOADING", f"{self._read} of {steps} steps read")

    def ask(self, command: dict[str, Any]) -> CommandAnswer:
        """Refuse the command, because no network is running."""
        return CommandAnswer(False, f"{command.get('do')}: this is a recording; nothing runs")

    def close(self) -> None:
        """Nothing is held open."""
        self._is_read = self._has_rested = True
