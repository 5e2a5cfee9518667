"""References of the controllers, and the road profile: signals held over whole steps."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Staircase:
    """Levels held for so many steps each, over and over: step -> (r,).

    levels: (k, r) as nested tuples; durations: (k,) steps.
    Raises ValueError for durations that do not pair with the levels or are not positive.
    """

    levels: tuple[tuple[float, ...], ...]
    durations: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.levels) != len(self.durations) or not self.levels:
            raise ValueError(
                f"a staircase of {len(self.levels)} levels has {len(self.durations)} durations; "
                "give one duration per level, and at least one level"
            )
        if min(self.durations) < 1:
            raise ValueError(
                f"durations {self.durations}: each level of a staircase lasts at least one step"
            )

    def __call__(self, step: int) -> np.ndarray:
        ends = np.cumsum(self.durations)
        return np.array(self.levels[np.searchsorted(ends, step % ends[-1], side="right")])


def constant(*level: float) -> Staircase:
    """Return the same level (r,) at every step."""
    return Staircase((level,), (1,))


def square(high: float, low: float, hold_steps: int) -> Staircase:
    """Two levels of a scalar in turn, hold_steps each."""
    return Staircase(((high,), (low,)), (hold_steps, hold_steps))
