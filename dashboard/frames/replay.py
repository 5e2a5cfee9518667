"""A recorded run as frames."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from concord.dashboard.frames.assembler import Assembler
from concord.dashboard.frames.frame import StepFrame
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
