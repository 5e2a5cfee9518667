"""Motion and readings of a bounded plant: the input of filters that cut with the data.

A state x (n,) and noise v, g samples of q numbers each in the unit ball. Noise maps have shape
(rows, g, q); leading axes are lanes.
"""

from typing import NamedTuple

import numpy as np

from concord.filters.linalg import multiply


class BoundedMotion(NamedTuple):
    """Quantity to bound: state (..., k, n) x + noise (..., k, g, q) v."""

    state: np.ndarray
    noise: np.ndarray


class Readings(NamedTuple):
    """Known constraints: |values - state x - noise v| <= half_widths, row by row; 0 is an equation.

    state (..., m, n), noise (..., m, g, q), values and half_widths (..., m). A NaN value marks
    a reading that was not taken.
    """

    state: np.ndarray
    noise: np.ndarray
    values: np.ndarray
    half_widths: np.ndarray


class StepReadings(NamedTuple):
    """One step: what becomes of the state, the readings that are exact, and those that are not."""

    motion: BoundedMotion
    exact: Readings
    bounded: Readings


def bus_evidence(
    motion: BoundedMotion,
    outputs: Readings,
    static: int,
    weights: np.ndarray,
    held: np.ndarray,
    winner: np.ndarray,
    limit: np.ndarray,
) -> StepReadings:
    """Return the evidence of one communication cycle.

    The first `static` outputs and the winner of the others are known exactly. Of each loser the
    bus tells that its weighted squared change was not larger than `limit`.

    Args:
        motion: over the cycle, or over its last step.
        outputs: of all m outputs, each in the step in which it was or would have been sent; only
            the values that were sent are looked at.
        weights: (c,) of the contending outputs. held: (..., c), their values before.
        winner: (...), which of them was sent.
        limit: (...), of the winner's weighted squared change and the resolution of the bus.
    """
    count = len(weights)
    winner = np.asarray(winner)[..., None]
    lost = np.arange(max(count - 1, 0)) + (np.arange(max(count - 1, 0)) >= winner)
    turns = np.broadcast_to(np.arange(static), (*winner.shape[:-1], static))
    sent = np.concatenate([turns, static + winner], axis=-1) if count else turns
    exact = _rows(outputs, sent, outputs.values, np.zeros(sent.shape))
    if count < 2:
        return StepReadings(motion, exact, no_readings(outputs))
    half_widths = np.sqrt(np.asarray(limit)[..., None] / weights[lost])
    centres = np.concatenate([outputs.values[..., :static], held], axis=-1)
    return StepReadings(motion, exact, _rows(outputs, static + lost, centres, half_widths))


def no_readings(like: Readings) -> Readings:
    """None, with the other sizes of `like`."""
    return Readings(
        like.state[..., :0, :],
        like.noise[..., :0, :, :],
        like.values[..., :0],
        like.half_widths[..., :0],
    )


def taken(readings: Readings) -> Readings:
    """With rows that say nothing, |0| <= 1, where no value was taken."""
    missing = np.isnan(readings.values)
    if not missing.any():
        return readings
    return Readings(
        np.where(missing[..., None], 0.0, readings.state),
        np.where(missing[..., None, None], 0.0, readings.noise),
        np.where(missing, 0.0, readings.values),
        np.where(missing, 1.0, readings.half_widths),
    )


def magnitudes(state: np.ndarray, noise: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Bound (..., rows) on |state x + noise v| entry by entry where |x| <= reach."""
    return multiply(np.abs(state), reach) + np.sqrt((noise**2).sum(-1)).sum(-1)


def _rows(
    outputs: Readings, which: np.ndarray, values: np.ndarray, half_widths: np.ndarray
) -> Readings:
    """The rows `which` (..., r) of the outputs, lane by lane."""
    return Readings(
        outputs.state[which],
        outputs.noise[which],
        np.take_along_axis(values, which, -1),
        half_widths,
    )
