"""The run beside the shown one: its frames, and whether both are of one truth."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.source import RecordedSource
from concord.scenarios.setup import Setup

BATCHES = 10
# A batch of one step tells nothing of how steps depend on each other.
_LEAST_STEPS = 2 * BATCHES

RatioInterval = Callable[[np.ndarray, np.ndarray], tuple[float, float, float]]
"""(mean squares (R,), those of another run (R,)) -> the ratio of the roots of their means, and the
bounds of its interval of 95 %; NaN where unknown."""


def refuse_unlike(first: Setup, second: Setup, labels: tuple[str, str]) -> None:
    """Refuse two runs that are not of one truth.

    Raises:
        ValueError: scenario, nodes, seed, run or sampling time differ.
    """
    one, other = first.scenario, second.scenario
    facts = (
        ("scenario", one.name, other.name),
        ("nodes", one.nodes, other.nodes),
        ("seed", one.seed, other.seed),
        ("run", one.run, other.run),
        ("time step", first.time_step_s, second.time_step_s),
        ("initial state", first.initial_state, second.initial_state),
        ("plant", one.plant, other.plant),
    )
    for name, mine, theirs in facts:
        if mine != theirs:
            raise ValueError(
                f"{name}: {mine} in {labels[0]}, {theirs} in {labels[1]}; two runs on a page must "
                "have one scenario and one seed, so make one of them again with the other's"
            )


class PairedScores(NamedTuple):
    """Scores (T,) of the scored steps that both runs have; `first` and `second` are the runs."""

    steps: np.ndarray
    first: dict[str, np.ndarray]
    second: dict[str, np.ndarray]


_SCORES: dict[str, Callable[[StepFrame], float]] = {
    "rmse": lambda f: f.scores.rmse,
    "spread": lambda f: f.scores.spread,
    "nees": lambda f: f.scores.nees,
    "central": lambda f: f.scores.central,
    "payload": lambda f: sum(one.payload_bytes for one in f.cycles),
    "missed": lambda f: sum(len(one.missed) for one in f.cycles),
}


class OtherRun:
    """Reads the recording beside the shown one, and keeps the scores of both, step by step.

    `labels` are the names of the shown run and of the other one.
    """

    def __init__(
        self, source: RecordedSource, labels: tuple[str, str], ratio: RatioInterval
    ) -> None:
        self._source, self.labels, self.ratio = source, labels, ratio
        self.stage, self.history = source.stage, FrameHistory(source.stage)
        self._judged = source.stage.score.first_step - 1
        self._steps: list[int] = []
        self._rows: tuple[list[list[float]], list[list[float]]] = [], []

    def poll(self) -> None:
        """Read the next frames."""
        self.history.add(self._source.poll())

    def at(self, step: int) -> StepFrame | None:
        """Return the frame of a step; None where this run has none."""
        if not len(self.history):
            return None
        frame = self.history.at(step)
        return frame if frame.step == step else None

    def beside(self, frames: Sequence[StepFrame]) -> list[StepFrame]:
        """Return the frames of the same steps, as far as there are any."""
        return [other for frame in frames if (other := self.at(frame.step)) is not None]

    def paired(self, shown: FrameHistory, step: int) -> PairedScores:
        """Return the scores of both runs up to a step."""
        for frame in shown.after(self._judged):
            other = self.at(frame.step)
            if other is None:
                break
            self._judged = frame.step
            self._steps.append(frame.step)
            for rows, one in zip(self._rows, (frame, other), strict=True):
                rows.append([value(one) for value in _SCORES.values()])
        count = int(np.searchsorted(self._steps, step, side="right"))
        first, second = (
            dict(zip(_SCORES, np.array(rows[:count]).reshape(count, len(_SCORES)).T, strict=True))
            for rows in self._rows
        )
        return PairedScores(np.array(self._steps[:count]), first, second)


def batched(values: np.ndarray) -> np.ndarray:
    """Return the means (10,) of batches of consecutive steps; too few steps have none.

    Batch means are nearly independent where steps are not (Law 2015, section 9.5.3).
    """
    if len(values) < _LEAST_STEPS:
        return np.zeros(0)
    return np.array([batch.mean() for batch in np.array_split(values, BATCHES)])


def running_mean(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean of the first k values, for each k, and its interval of 95 % (T,), by the
    means of `BATCHES` batches of them."""
    count = len(values)
    sums = np.concatenate([[0.0], np.cumsum(values)])
    k = np.arange(1, count + 1)
    mean = sums[1:] / k
    low = high = np.full(count, np.nan)
    if count >= _LEAST_STEPS:
        # Only here: scipy takes longer to load than a page may wait for its first picture.
        from scipy.special import stdtrit

        edges = k[:, None] * np.arange(BATCHES + 1) // BATCHES
        means = np.diff(sums[edges], axis=1) / np.maximum(np.diff(edges, axis=1), 1)
        half = stdtrit(BATCHES - 1, 0.975) * means.std(axis=1, ddof=1) / np.sqrt(BATCHES)
        half = np.where(k >= _LEAST_STEPS, half, np.nan)
        low, high = mean - half, mean + half
    return mean, low, high
