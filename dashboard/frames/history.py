"""The frames that can still be shown: all of them, or the newest where memory is short."""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from concord.dashboard.frames.frame import LogEntry, StepFrame
from concord.dashboard.frames.stage import Stage

_MEMORY_BYTES = 200_000_000
_MOST_FRAMES = 20_000
_LOG_LINES = 500
_ENOUGH = 15


class FrameHistory:
    """Frames in order of steps, and the log."""

    def __init__(self, stage: Stage) -> None:
        n = len(stage.setup.prior_mean)
        frame_bytes = 8 * (stage.nodes * (n + n * n + 16) + 3 * len(stage.heard)) + 2000
        self._limit = max(100, min(_MOST_FRAMES, _MEMORY_BYTES // frame_bytes))
        self._first_scored = stage.score.first_step
        self._frames: list[StepFrame] = []
        self._steps: list[int] = []
        self.log: deque[LogEntry] = deque(maxlen=_LOG_LINES)

    def add(self, frames: Iterable[StepFrame]) -> None:
        """Keep frames, in order of steps."""
        for frame in frames:
            self._frames.append(frame)
            self._steps.append(frame.step)
            self.log.extend(frame.events)
        # In one go now and then: the beginning of a list is dear to remove.
        if len(self._frames) > 1.25 * self._limit:
            del self._frames[: -self._limit]
            del self._steps[: -self._limit]

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def first_step(self) -> int:
        """Of the oldest frame that is kept."""
        return self._frames[0].step if self._frames else 0

    @property
    def last_step(self) -> int:
        """Of the newest frame."""
        return self._frames[-1].step if self._frames else 0

    def at(self, step: int) -> StepFrame:
        """Return the frame of a step, or the nearest there is."""
        return self._frames[self._index(step)]

    def until(self, step: int, most: int) -> list[StepFrame]:
        """At most so many frames up to and with a step."""
        last = self._index(step)
        return self._frames[max(0, last + 1 - most) : last + 1]

    def after(self, step: int) -> Iterator[StepFrame]:
        """Return the frames after a step, in order."""
        return islice(self._frames, bisect_right(self._steps, step), None)

    def sampled(self, step: int, most: int, steps: int = _MOST_FRAMES) -> list[StepFrame]:
        """Return at most `most` of the last `steps` frames up to a step, evenly thinned.

        Steps that the scenario does not score are left out once there are enough others: the errors
        of a wide prior would leave no room for the rest.
        """
        count = self._index(step) + 1
        begin = max(self._unscored(count), count - steps)
        stride = max(1, -(-(count - begin) // most))
        return self._frames[begin + (count - 1 - begin) % stride : count : stride]

    def _unscored(self, count: int) -> int:
        """Return how many of the first `count` frames no chart shows."""
        unscored = bisect_right(self._steps, self._first_scored - 1)
        return unscored if count > unscored + _ENOUGH else 0

    def _index(self, step: int) -> int:
        # Of a fast network some steps are left out.
        return max(0, bisect_right(self._steps, step) - 1)


def state_table(frames: Sequence[StepFrame], node: int, state: int) -> np.ndarray:
    """Return truth, a node's estimate and its standard deviation (T, 3) of one state.

    A node that is down estimates nothing: NaN.
    """
    rows = [
        (f.truth[state], f.belief.mean[node, state], f.belief.cov[node, state, state])
        if f.alive[node]
        else (f.truth[state], np.nan, np.nan)
        for f in frames
    ]
    table = np.array(rows).reshape(-1, 3)
    table[:, 2] = np.sqrt(np.maximum(table[:, 2], 0.0))
    return table
