"""The messages of one whole step, decoded."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from concord.bus.bus import FrameFormat, Rejected
from concord.nodes.bounds import node_of
from concord.nodes.messages import Estimate, Measured, Truth, from_wire
from concord.runtime.recorded import fits, message_of
from concord.runtime.whole_steps import WholeStep
from concord.scenarios.setup import Setup


@dataclass
class StepContent:
    """The content of a step, by (cycle, node): `sizes` are payload bytes, `frame_ids` one ID of the
    share."""

    truth: Truth | None = None
    measured: dict[int, Measured] = field(default_factory=dict)
    estimates: dict[int, Estimate] = field(default_factory=dict)
    sizes: Counter[tuple[int, int]] = field(default_factory=Counter)
    frame_ids: dict[tuple[int, int], int] = field(default_factory=dict)


class StepReader:
    """Reads the steps of a run, whose shares are frames of a format; ignores what is no message of
    this network, and readings of another shape than most of its first step have."""

    def __init__(self, setup: Setup, frames: FrameFormat) -> None:
        self._setup, self._frames = setup, frames
        self._shape: tuple[int, ...] | None = None

    def read(self, step: WholeStep) -> StepContent:
        """Return the content of a step."""
        told, nodes = StepContent(), self._setup.scenario.nodes
        for topic, data in step.messages:
            kind, _, number = topic.partition("/")
            if kind == "share":
                _read_share(told, node_of(number, nodes), data, self._frames)
                continue
            message = message_of(topic, data, nodes)
            if not fits(message, self._setup):
                continue
            match message:
                case Truth():
                    told.truth = message
                case Measured():
                    told.measured[message.node] = message
                case Estimate():
                    told.estimates[message.node] = message
                case _:
                    pass
        shapes = {i: from_wire(one.readings).shape for i, one in told.measured.items()}
        if self._shape is None and shapes:
            self._shape, _ = Counter(shapes.values()).most_common()[0]
        told.measured = {i: one for i, one in told.measured.items() if shapes[i] == self._shape}
        return told


def delivered(told: StepContent, nodes: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Readings (N, r, d), NaN for a node without a heartbeat, and the control (p,) into the step;
    None for what the step does not tell."""
    if not told.measured:
        return None, None
    example = next(iter(told.measured.values()))
    nothing = np.full_like(from_wire(example.readings), np.nan)
    readings: np.ndarray = np.stack(
        [
            from_wire(told.measured[i].readings) if i in told.measured else nothing
            for i in range(nodes)
        ]
    )
    return readings, None if example.control is None else np.array(example.control)


def _read_share(told: StepContent, sender: int | None, data: bytes, frames: FrameFormat) -> None:
    try:
        fragment = frames.read(data)
    except Rejected:
        return
    if sender is not None:
        told.sizes[fragment.cycle, sender] += len(data) - frames.overhead_bytes
        told.frame_ids[fragment.cycle, sender] = fragment.frame_id
