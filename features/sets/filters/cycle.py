"""One communication cycle as a set-membership filter sees it: what is unknown, and what is known.

The unknowns are u, where in its ellipsoid the state was, and the noise v of the cycle's g samples,
each within the unit ball. Noise maps have shape (rows, g, q).

Source: Liu et al. (2021), section V.
"""

import math
from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.criterion import Criterion
from concord.features.sets.filters.ellipsoid import (
    Ellipsoid,
    grow,
    half_widths,
    is_lost,
    lose,
    squared,
)
from concord.features.sets.filters.lifted_cycle import AugmentedCycle
from concord.features.sets.filters.rounding import (
    RANK_TOLERANCE,
    magnitudes,
    rounding_bound,
    row_units,
)
from concord.filters.linalg import join_columns, multiply, squared_lengths


class CycleResult(NamedTuple):
    """Result of a filter for one cycle: the ellipsoid after it, the feedback L (..., N, m), and the
    duality gap (...) relative to the trace; NaN of a filter that solves no programme."""

    after: Ellipsoid
    gain: np.ndarray
    gap: np.ndarray


class Unknowns(NamedTuple):
    """Next state and received values: linear maps (..., N, d), (..., m, d) of (u, v)."""

    image: np.ndarray
    known: np.ndarray


def heard(cycle: AugmentedCycle, received: np.ndarray) -> tuple[AugmentedCycle, np.ndarray]:
    """The cycle and the values (..., m) with rows that say nothing, 0 = 0, for values that are NaN.

    A lost frame leaves a prediction. `winner` -1 marks a dynamic frame that no node has heard.
    """
    missing = np.isnan(received)
    if not missing.any():
        return cycle, received
    output = np.where(missing[..., None], 0.0, cycle.output)
    output_noise = np.where(missing[..., None, None], 0.0, cycle.output_noise)
    values = np.where(missing, 0.0, received)
    return cycle._replace(output=output, output_noise=output_noise), values


def check_sizes(before: Ellipsoid, cycle: AugmentedCycle, received: np.ndarray) -> None:
    """Refuse an ellipsoid or received values that do not fit the cycle.

    Raises:
        ValueError: naming the sizes.
    """
    outputs, size = cycle.output.shape[-2:]
    if before.centre.shape[-1] != size or before.factor.shape[-2] != size:
        raise ValueError(
            f"an ellipsoid with centre {before.centre.shape} and factor {before.factor.shape} for "
            f"{size} augmented states; give the states of all steps of a cycle and the held values"
        )
    if received.shape[-1] != outputs:
        raise ValueError(
            f"{received.shape[-1]} received values for {outputs} outputs; give one for each, NaN "
            "where a frame was lost"
        )


def unknowns(position: np.ndarray, cycle: AugmentedCycle) -> Unknowns:
    """Errors of the state and of the received values as they come from u and v.

    position: (..., N, r), a factor of the ellipsoid before, `turned` or as it is.
    """
    noise, output_noise = flat(cycle.noise), flat(cycle.output_noise)
    image = join_columns(cycle.transition @ position, noise)
    known = join_columns(cycle.output @ position, output_noise)
    return Unknowns(image, known)


def turned(factor: np.ndarray, cycle: AugmentedCycle) -> np.ndarray:
    """The factor with u turned so that as few entries as possible are seen; the others left out.

    The cycle depends on only some coordinates of the state (the last block and the held values).
    With those rows made triangular, the other columns have no effect, and the worst u is 0 there.
    """
    used = _columns_in_use(cycle.transition)
    used = used | _columns_in_use(cycle.output) | _columns_in_use(cycle.candidates)
    seen = squared(factor[..., used, :])
    position = np.zeros((*factor.shape[:-1], seen.shape[-1]))
    position[..., used, :] = seen
    return position


def _columns_in_use(matrix: np.ndarray) -> np.ndarray:
    """Which columns (n,) of matrices (..., k, n) are not zero in all lanes."""
    return np.asarray(matrix.any(tuple(range(matrix.ndim - 1))))


class Proof(NamedTuple):
    """Proof of a filter for one cycle.

    Attributes:
        factor, gain: (..., N, d) around the error that is left under the feedback (..., N, m).
        known, seen: (..., m, d), the received values as maps of a theta that is at most 1 long,
            and the pseudo-inverse of this map.
        gap: as in `CycleResult`.
        uncut: half-widths (..., N) without the feedback.
    """

    factor: np.ndarray
    gain: np.ndarray
    known: np.ndarray
    seen: np.ndarray
    gap: np.ndarray
    uncut: np.ndarray


def follow(
    before: Ellipsoid,
    cycle: AugmentedCycle,
    received: np.ndarray,
    proof: Proof,
    criterion: Criterion,
) -> CycleResult:
    """(17) and the shape that was found, grown by the rounding of the whole step.

    NaN in lanes in which no error within the bounds explains what was received.
    """
    innovation = received - multiply(cycle.output, before.centre)
    centre = multiply(cycle.transition, before.centre) + multiply(proof.gain, innovation)
    of_outputs, margin = _rounding(before, cycle, received, proof.gain)
    after = grow(Ellipsoid(centre, proof.factor), margin, criterion, proof.uncut)
    lost = is_lost(after) | _contradicts(proof, innovation, of_outputs)
    if not lost.any():
        return CycleResult(after, proof.gain, proof.gap)
    return CycleResult(lose(after, lost), proof.gain, np.where(lost, np.nan, proof.gap))


def parted(share: np.ndarray, seen: int, size: int) -> np.ndarray:
    """Factors (..., 1, size) that make every (u, v) at most 1 long that is within its `radii`.

    share: a (...) of u, the first `seen` entries; the g samples v, all in their balls, have 1 - a.
    """
    first = np.arange(size) < seen
    share = share[..., None, None]
    return np.sqrt(np.where(first, share, 1.0 - share))


def radii(seen: int, size: int, samples: int) -> np.ndarray:
    """Lengths (size,) that u, the first `seen` entries, and the g samples v reach, each alone."""
    lengths = np.full(size, math.sqrt(samples * (1.0 + rounding_bound(size))))
    lengths[:seen] = math.sqrt(1.0 + rounding_bound(size))
    return lengths


def flat(noise: np.ndarray) -> np.ndarray:
    """Noise map (..., rows, g, q) as a matrix (..., rows, g q)."""
    return noise.reshape(*noise.shape[:-2], noise.shape[-2] * noise.shape[-1])


def ball(first: int, count: int, size: int, radius: float) -> np.ndarray:
    """The term (size, size) of |theta[first : first + count]|^2 <= radius."""
    diagonal = np.zeros(size)
    diagonal[first : first + count] = 1.0
    diagonal[0] = -radius
    return np.diag(diagonal)


def _rounding(
    before: Ellipsoid, cycle: AugmentedCycle, received: np.ndarray, gain: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Half-widths (..., m) and (..., N) within which outputs and states, of truth and filter, both
    rounded, part from their equations."""
    of = cycle.majorant or cycle
    reach = np.abs(before.centre) + half_widths(before)
    outputs = magnitudes(of.output, of.output_noise, reach) + np.abs(received)
    states = magnitudes(of.transition, of.noise, reach) + multiply(np.abs(gain), outputs)
    bound = rounding_bound(cycle.transition.shape[-1] + cycle.noise[0, ...].size)
    return bound * outputs, bound * states


def _contradicts(proof: Proof, innovation: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Whether (...) no theta at most 1 long explains an innovation (..., m) to within an error."""
    shortest = multiply(proof.seen, innovation)
    slack = np.sqrt(squared_lengths(multiply(np.abs(proof.seen), error)))
    too_long = np.sqrt(squared_lengths(shortest)) > 1.0 + slack + RANK_TOLERANCE
    # The part that no theta reaches, however long, is left over.
    units = row_units(proof.known)
    seen = (proof.known != 0.0).any(-1)
    left = np.abs(innovation - multiply(proof.known, shortest)) / units
    allowed = np.where(seen, error / units, 0.0)
    allowed = np.sqrt(squared_lengths(allowed))[..., None] + RANK_TOLERANCE * left.shape[-1]
    beside = np.where(seen, left > 2.0 * allowed, np.abs(innovation) > error)
    return np.asarray(too_long | beside.any(-1))
