"""The feed of whole steps for subscribers: all of a slow network, the newest few of a fast one.

Its cost does not grow with the network's speed.
"""

from concord.runtime.whole_steps import WholeStep

STEPS_PER_S = 20.0
AT_ONCE = 600
"""Largest burst of steps: what a network at that rate catches up after a stall of half a minute."""


class ThrottledFeed:
    """Chooses among steps that are over, by a clock that the caller reads.

    The last one before a rest is chosen always, if `due` is asked for once its time has come.
    """

    def __init__(self, at_once: int = AT_ONCE) -> None:
        self._at_once = at_once
        self._free_s = float("-inf")
        self._kept: WholeStep | None = None

    def take(self, step: WholeStep, now_s: float) -> WholeStep | None:
        """The next step that is over: the one to be offered now, if there is one."""
        self._kept = step
        return self.due(now_s)

    def due(self, now_s: float) -> WholeStep | None:
        """The newest step, if it was kept and its time has come."""
        if self._kept is None or self.rest_s(now_s) > 0:
            return None
        step, self._kept = self._kept, None
        self._free_s = (
            max(self._free_s, now_s - (self._at_once - 1) / STEPS_PER_S) + 1 / STEPS_PER_S
        )
        return step

    @property
    def keeps_one(self) -> bool:
        """Whether a step waits for its time."""
        return self._kept is not None

    def rest_s(self, now_s: float) -> float:
        """How long it is until the next step may be offered."""
        return max(0.0, self._free_s - now_s)
