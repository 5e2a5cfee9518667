"""Provenance of an estimate: the shares that a node used in a step, as node and bus told them."""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from concord.bus.bus import Transmission
from concord.dashboard.frames.frame import StepFrame

STEPS_BACK = 60
"""Number of steps, the shown one included, in which the frames of held shares are looked up."""


class ShareArrival(Enum):
    """How the share of a neighbour came to a node, or why it did not."""

    FRESH = "came in time"
    HELD = "newest it sent"
    LOST = "newest lost"
    CUT = "link cut"
    DOWN = "sender down"
    NEVER = "never heard"


class UsedShare(NamedTuple):
    """A share that a node held at the end of a step.

    `age_cycles` counts from its cycle to the last of the step, -1 for none; `weight` is that of the
    last round, NaN of a rule that tells none. `step`, `bus_cycle` and `frames` tell where it was on
    the bus; without frames its step is too long ago.
    """

    sender: int
    arrival: ShareArrival
    age_cycles: int
    weight: float
    step: int | None = None
    bus_cycle: int | None = None
    frames: tuple[Transmission, ...] = ()


class Provenance(NamedTuple):
    """Own weight of a node (NaN: not told), and the shares that it held for its estimate."""

    own_weight: float
    shares: tuple[UsedShare, ...]


def provenance(past: Sequence[StepFrame], node: int) -> Provenance:
    """Return what made a node's estimate in the last of these frames, in order of steps."""
    frame = past[-1]
    stage = frame.stage
    positions = np.flatnonzero(stage.heard[:, 0] == node)
    shares = tuple(_share(past, int(position)) for position in positions)
    told = frame.weights[positions]
    return Provenance(1.0 - float(told.sum()), shares)


def _share(past: Sequence[StepFrame], position: int) -> UsedShare:
    frame = past[-1]
    sender, age = int(frame.stage.heard[position, 1]), int(frame.ages[position])
    arrival, weight = _arrival(frame, position), float(frame.weights[position])
    if age < 0:
        return UsedShare(sender, arrival, age, weight)
    wanted = frame.cycles[-1].cycle - age
    for earlier in reversed(past):
        for cycle in earlier.cycles:
            if cycle.cycle == wanted:
                frames = tuple(one for one in cycle.frames if one.node == sender)
                return UsedShare(
                    sender, arrival, age, weight, earlier.step, cycle.bus_cycle, frames
                )
    return UsedShare(sender, arrival, age, weight)


def _arrival(frame: StepFrame, position: int) -> ShareArrival:
    stage, (receiver, sender) = frame.stage, frame.stage.heard[position]
    if frame.ages[position] < 0:
        return ShareArrival.NEVER
    if frame.ages[position] == 0:
        return ShareArrival.FRESH
    if not frame.alive[sender]:
        return ShareArrival.DOWN
    ends = sorted((int(receiver), int(sender)))
    if len(stage.edges) and frame.cut[(stage.edges == ends).all(axis=1)].any():
        return ShareArrival.CUT
    return ShareArrival.LOST if frame.lost[position] else ShareArrival.HELD
