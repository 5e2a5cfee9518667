"""Drawn cases that are sound, and that an earlier verdict of the laboratory complained of."""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Sound(NamedTuple):
    """A case, by its seed and what is fixed of it, and what was taken for a bug."""

    seed: int
    reason: str
    fixed: Mapping[str, Any] = {}


SOUND = (
    Sound(700176, "the target is seen again after long"),
    Sound(700345, "the target is predicted for long along an uncertain turn"),
    Sound(940260, "the filter alone makes these errors too"),
    Sound(228, "a frame of a later step arrives in a slot that is not its sender's"),
    Sound(700315, "a set is 3e-4 wide in one slanted direction and 2 in others"),
    Sound(990448, "sets are twice as large for ten steps, where a node hears little"),
    Sound(980206, "which reading reaches a node in a single step is luck"),
    Sound(992736, "a node at the end of a path hears nothing at all"),
    Sound(992354, "a rule that is set and set back has the hold policy that it had"),
    Sound(940032, "the plant's noise drives one state, whose variance falls to 1e-11"),
    Sound(940364, "the plant's noise lies on its bound"),
    Sound(1262, "rounding alone makes the digits that differ"),
    Sound(
        910018,
        "neighbours owe a node that joins a checkpoint of the beginning of their window",
        {
            "scenario": "oscillator",
            "nodes": 5,
            "loss": 0.0,
            "cluster": "fitted",
            "steps": 14,
            "changes": ("2 kill 0", "8 kill 4", "9 crc 2 0.78", "13 restart 4"),
        },
    ),
    Sound(
        995328,
        "node 5 is heard of never again, and its share is predicted at full weight for good",
        {
            "scenario": "oscillator",
            "weights": "metropolis",
            "wire": (),
            "changes": ("1 kill 4", "2 kill 3", "10 restart 4", "10 restart 3", "10 calm"),
        },
    ),
)
