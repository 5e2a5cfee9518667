"""Where frames come from: a recording that is played, or a network that runs."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from concord.dashboard.frames.assembler import Assembler
from concord.dashboard.frames.frame import LogEntry, StepFrame
from concord.dashboard.frames.stage import Stage
from concord.runtime.recording import read_recording
from concord.runtime.whole_steps import WholeStep, WholeSteps


def replayed(stage: Stage, recording: Path) -> Iterator[StepFrame]:
    """The frames of a recording, in order of steps.

    Raises:
        ValueError: the file is not a recording.
    """
    return assembled(stage, read_recording(recording))


def assembled(stage: Stage, messages: Iterable[tuple[str, bytes]]) -> Iterator[StepFrame]:
    """The frames that the (topic, bytes) of a run make, from its beginning on."""
    assembler = Assembler(stage)
    steps = WholeSteps(stage.nodes, stage.rounds, stage.bus.frame_format)
    for topic, data in messages:
        if topic == "event":
            assembler.hear(data)
        yield from _frames(assembler, steps.take(topic, data))
    yield from _frames(assembler, steps.rest())


def _frames(assembler: Assembler, steps: Iterable[WholeStep]) -> Iterator[StepFrame]:
    for step in steps:
        frame = assembler.frame(step)
        if frame is not None:
            yield frame


_FRAMES_PER_POLL = 40


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

    `verdict` is that of the whole run, in words; empty where there is none.
    """

    live = takes_commands = False

    def __init__(self, stage: Stage, recording: Path, verdict: str = "") -> None:
        self.stage = stage
        self._verdict = verdict and f"; the whole run: {verdict}"
        self._frames: Iterator[StepFrame] | None = replayed(stage, recording)
        self._read = 0

    def poll(self) -> list[StepFrame]:
        """Return the next few frames of the recording.

        Raises:
            ValueError: the file is not a recording.
        """
        frames: list[StepFrame] = []
        while self._frames is not None and len(frames) < _FRAMES_PER_POLL:
            frame = next(self._frames, None)
            if frame is None:
                self._frames = None
            else:
                frames.append(frame)
        self._read += len(frames)
        return frames

    def pace(self) -> SourceState:
        """A recording has no pace of its own; the player sets it."""
        if self._frames is None:
            return SourceState("RECORDED", f"{self._read} steps{self._verdict}")
        steps = self.stage.setup.scenario.steps
        return SourceState("LOADING", f"{self._read} of {steps} steps read")

    def ask(self, command: dict[str, Any]) -> CommandAnswer:
        """Refuse the command, because no network is running."""
        return CommandAnswer(False, f"{command.get('do')}: this is a recording; nothing runs")

    def close(self) -> None:
        """Nothing is held open."""
        self._frames = None
