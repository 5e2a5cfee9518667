"""How long a network takes to settle after a change: the start, a manoeuvre, a lost node."""

import numpy as np

from concord.results.figures.intervals import Interval

# Settled is what the error is over this last part of the run, and at most so many times that.
LAST_PART, WITHIN = 0.25, 1.5
RESAMPLES = 200


def settling_steps(error: np.ndarray, change_step: int) -> float:
    """Steps from the change until the error (R, steps) stays settled; NaN if it does not settle.

    The error is the root mean square over runs; one run alone crosses any threshold by chance.
    """
    return float(_settling(np.square(error).mean(axis=0)[None], change_step)[0])


def settling_interval(error: np.ndarray, change_step: int, confidence: float = 0.95) -> Interval:
    """Return the same with its bootstrap interval over runs; bounds are NaN for one run."""
    value = settling_steps(error, change_step)
    runs = len(error)
    if runs < 2 or np.isnan(value):
        return Interval(value, np.nan, np.nan)
    # A fixed seed: the same runs give the same interval.
    generator = np.random.default_rng(np.random.SeedSequence(0))
    picked = generator.integers(runs, size=(RESAMPLES, runs))
    again = _settling(np.square(error)[picked].mean(axis=1), change_step)
    again = again[~np.isnan(again)]
    if not len(again):
        return Interval(value, np.nan, np.nan)
    tail = (1 - confidence) / 2
    low, high = np.quantile(again, (tail, 1 - tail))
    return Interval(value, float(low), float(high))


def _settling(squares: np.ndarray, change_step: int) -> np.ndarray:
    """Of mean squared errors (B, steps): (B,)."""
    steps = squares.shape[-1]
    if not steps:
        return np.full(len(squares), np.nan)  # no error is known
    tail = max(1, round(LAST_PART * steps))
    settled = squares[:, -tail:].mean(axis=-1, keepdims=True)
    away = squares[:, change_step:-tail] > WITHIN**2 * settled
    if not away.shape[-1]:
        return np.full(len(squares), np.nan)
    last_away = np.where(away.any(-1), away.shape[-1] - 1 - away[:, ::-1].argmax(-1), -1)
    # Away up to the part that defines "settled": then nothing says that it ever was.
    after = np.where(last_away == away.shape[-1] - 1, np.nan, last_away + 1)
    return np.where(np.isnan(settled[:, 0]), np.nan, after)
