"""A recorded run as frames."""

from collections.abc import Iterator
from pathlib import Path

from dashboard.assembler import Assembler
from dashboard.frame import Frame
from dashboard.stage import Stage
from nodes.recording import read_recording


def replayed(stage: Stage, recording: Path) -> Iterator[Frame]:
    """The frames of a recording, in order of steps.

    Raises:
        ValueError: the file is not a recording.
    """
    assembler = Assembler(stage)
    for topic, data in read_recording(recording):
        yield from assembler.take(topic, data)
