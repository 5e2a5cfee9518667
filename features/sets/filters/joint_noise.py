"""Readings whose noise is the noise that drives the plant: what they say of a state and its noise.

A plant x' = A x + B v with |v| <= 1 is read as y = C x + D v + w. With a gain G, an inverse of D as
far as there is one, the noise is v = G (y - C x) + (I - G D) v. Three things follow:

- (I - D G)(y - C x) = 0: readings in which the noise cancels are exact;
- |G (y - C x)| <= 1: the others are strips as wide as the bound;
- x' = (A - B G C) x + B G y + B (I - G D) v: the noise that was read no longer spreads the state.

Any gain is sound; the one taken weighs readings by how much noise they show beside the state's own
spread, in no unit. All of it is in closed form, so that a lane by itself has the same numbers as
among others. `tight_estimator.conditioned_step` takes the same evidence at once and is tighter; it
takes 4 to 25 ms a step, and its lanes differ by 1e-10 from the same alone.

Source: the project's own; gains for noise that drives state and outputs are those of Combastel
(2015), Zonotopes and Kalman observers, with sets that are cut between.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.ellipsoid import squared
from concord.features.sets.filters.rounding import RANK_TOLERANCE, rounding_bound
from concord.filters.linalg import join_columns, join_entries, join_rows, multiply


class LinearReadings(NamedTuple):
    """Readings y = C x + D v + w of lanes, |v| <= 1 the noise of the plant, |w| <= half_widths.

    state C (..., m, n), noise D (..., m, q), half_widths (..., m), values y (..., m); a NaN value
    was not taken.
    """

    state: np.ndarray
    noise: np.ndarray
    half_widths: np.ndarray
    values: np.ndarray

    def taken(self) -> "LinearReadings":
        """Return the same with rows of zeros, 0 = 0, where no value was taken.

        Of a reading with noise of its own, all noise is its own.
        """
        missing = np.isnan(self.values)
        shared = np.where(self.half_widths[..., None] > 0.0, 0.0, self.noise)
        whole = self.half_widths + np.sqrt(((self.noise - shared) ** 2).sum(-1))
        return LinearReadings(
            np.where(missing[..., None], 0.0, self.state),
            np.where(missing[..., None], 0.0, shared),
            np.where(missing, 0.0, whole),
            np.where(missing, 0.0, self.values),
        )


def joined(parts: Sequence[LinearReadings]) -> LinearReadings:
    """Return readings of several sensors as those of one."""
    states, noises, half_widths, values = zip(*parts, strict=True)
    return LinearReadings(
        join_rows(*states), join_rows(*noises), join_entries(*half_widths), join_entries(*values)
    )


class Strips(NamedTuple):
    """Known of a state: |values - rows x| <= half_widths, (..., s, n) and (..., s)."""

    rows: np.ndarray
    values: np.ndarray
    half_widths: np.ndarray


class JointMotion(NamedTuple):
    """The next state given readings: x' = transition x + offset + noise v, |v| <= 1.

    transition (..., n, n), offset (..., n), noise (..., n, n), with columns of zeros to spare;
    margin (..., n) is how far rounding may have moved the sum. NaN in lanes without readings.
    """

    transition: np.ndarray
    offset: np.ndarray
    noise: np.ndarray
    margin: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """Whether (...) a lane had readings."""
        return ~np.isnan(self.offset[..., 0])

    def where(self, used: np.ndarray) -> "JointMotion":
        """Return the same with NaN in lanes (...) without readings."""
        return JointMotion(
            np.where(used[..., None, None], self.transition, np.nan),
            np.where(used[..., None], self.offset, np.nan),
            np.where(used[..., None, None], self.noise, np.nan),
            np.where(used[..., None], self.margin, np.nan),
        )


def no_joint_motion(lanes: tuple[int, ...], states: int) -> JointMotion:
    """Return that of lanes without readings."""
    vector, matrix = np.full((*lanes, states), np.nan), np.full((*lanes, states, states), np.nan)
    return JointMotion(matrix, vector, matrix, vector)


def noise_gain(taken: LinearReadings, half_widths: np.ndarray) -> np.ndarray:
    """The gain G (..., q, m) for a state in a set of these half-widths (..., n)."""
    spread = multiply(np.abs(taken.state), half_widths)
    units = np.hypot(spread, np.sqrt((taken.noise**2).sum(-1)))
    units = np.where(units > 0.0, units, 1.0)[..., None]
    gain: np.ndarray = np.linalg.pinv(taken.noise / units, rcond=RANK_TOLERANCE) / units.mT
    return gain


def strips_of(taken: LinearReadings, gain: np.ndarray, reach: np.ndarray) -> Strips:
    """The exact readings and the strips for states with |x| <= reach (..., n), exact ones first."""
    count = taken.state.shape[-2]
    exact = np.eye(count) - taken.noise @ gain
    # Readings that the gain uses up leave rounding, which says nothing.
    exact *= np.abs(exact).max(-1, keepdims=True) > RANK_TOLERANCE
    turned = join_rows(exact, gain)
    size = _magnitude(taken, reach)
    bound = rounding_bound(sum(taken.noise.shape[-2:]) + reach.shape[-1])
    turns = np.abs(turned)
    # The two parts of a difference are rounded too, though little may be left of them.
    turns[..., :count, :] += np.eye(count) + np.abs(taken.noise) @ np.abs(gain)
    half_widths = bound * multiply(turns, size) + multiply(np.abs(turned), taken.half_widths)
    # A gain that leaves the weakest noise out leaves it in the readings.
    half_widths[..., :count] += np.sqrt(((exact @ taken.noise) ** 2).sum(-1))
    half_widths[..., count:] += 1.0
    return Strips(turned @ taken.state, multiply(turned, taken.values), half_widths)


def joint_motion(
    taken: LinearReadings,
    gain: np.ndarray,
    reach: np.ndarray,
    transition: np.ndarray,
    noise: np.ndarray,
) -> JointMotion:
    """The next state under A (n, n) and B (n, q), as for `strips_of`."""
    # Readings with noise of their own have no part in the gain.
    through = noise @ gain
    bound = rounding_bound(sum(taken.noise.shape[-2:]) + reach.shape[-1])
    sizes = np.abs(noise) @ np.abs(gain)
    left = squared(noise - through @ taken.noise)
    spare = np.zeros((*left.shape[:-1], left.shape[-2] - left.shape[-1]))
    lost = bound * (multiply(sizes, _magnitude(taken, reach)) + multiply(np.abs(transition), reach))
    return JointMotion(
        transition - through @ taken.state,
        multiply(through, taken.values),
        join_columns(left, spare),
        lost + bound * np.abs(noise).sum(-1),
    )


def _magnitude(taken: LinearReadings, reach: np.ndarray) -> np.ndarray:
    """Bound (..., m) on all that a reading is summed from."""
    own = np.sqrt((taken.noise**2).sum(-1))
    return multiply(np.abs(taken.state), reach) + np.abs(taken.values) + own
