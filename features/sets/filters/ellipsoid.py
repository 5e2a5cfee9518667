"""Ellipsoids as sets that hold a state for certain, and what keeps them so in floating point.

An ellipsoid is kept as its centre and a factor, never as an inverse shape: a flat one (a state that
is known exactly in some direction) is as good as any other. A function that computes a new
ellipsoid grows it by a bound on its own rounding (`rounding.py`, `grow`). The result therefore
holds the true state and not only the state of exact arithmetic. No function mixes the units of the
states: with x' = T x for a diagonal T, the sets are T times as wide, and otherwise the same.
"""

import functools
from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.criterion import Criterion, unit_free
from concord.features.sets.filters.rounding import magnitudes, rounding_bound, row_units
from concord.filters.linalg import join_columns, multiply, squared_lengths

# A state that is known better than it is rounded widens the others by no larger part (`grow`).
_MOST_SHARE = 2.0**-16


class Ellipsoid(NamedTuple):
    """{centre + factor u : |u| <= 1} per lane: centre (..., n), factor (..., n, r), any r >= 1.

    Its shape matrix is P = factor factor'; where P can be inverted the set is e' P^-1 e <= 1.
    """

    centre: np.ndarray
    factor: np.ndarray


def from_shape(centre: np.ndarray, shape: np.ndarray) -> Ellipsoid:
    """The ellipsoid with a shape matrix (..., n, n), which may be singular; factor (..., n, n)."""
    widths = np.sqrt(np.diagonal(shape, axis1=-2, axis2=-1))
    units = np.where(widths > 0.0, widths, 1.0)
    values, vectors = np.linalg.eigh(shape / (units[..., :, None] * units[..., None, :]))
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return Ellipsoid(centre, units[..., None] * root)


def shape_matrix(ellipsoid: Ellipsoid) -> np.ndarray:
    """P (..., n, n)."""
    return ellipsoid.factor @ ellipsoid.factor.mT


def half_widths(ellipsoid: Ellipsoid) -> np.ndarray:
    """Largest distance (..., n) from the centre along each axis: the roots of P's diagonal."""
    return np.sqrt(squared_lengths(ellipsoid.factor))


def squared_radius(ellipsoid: Ellipsoid, point: np.ndarray) -> np.ndarray:
    """|u|^2 (...) of the shortest u with centre + factor u = point (..., n): e' P^+ e.

    At most 1 inside. A direction in which the ellipsoid is exactly flat admits no deviation, not
    even one of rounding: infinite there.
    """
    lost = is_lost(ellipsoid)
    factor = np.where(lost[..., None, None], 0.0, ellipsoid.factor)
    # A state that is known exactly says yes or no; its row is no part of the other directions.
    exact = np.logical_not(factor.any(-1))
    units = row_units(factor)
    factor = join_columns(factor / units[..., None], exact[..., None] * np.eye(factor.shape[-2]))
    left, singular, _ = np.linalg.svd(factor, full_matrices=True)
    offset = (point - ellipsoid.centre) / units
    along = multiply(left.mT, np.where(exact, 0.0, offset))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.where((singular == 0.0) & (along == 0.0), 0.0, along / singular)
        radius = np.where((exact & (offset != 0.0)).any(-1), np.inf, (ratio**2).sum(-1))
    return np.where(lost, np.nan, radius)


def is_lost(ellipsoid: Ellipsoid) -> np.ndarray:
    """Lanes (...) in which an ellipsoid is not a number."""
    finite_centre = np.isfinite(ellipsoid.centre).all(-1)
    finite_factor = np.isfinite(ellipsoid.factor).all((-1, -2))
    return np.logical_not(np.logical_and(finite_centre, finite_factor))


def replace_lost(ellipsoid: Ellipsoid, value: float) -> Ellipsoid:
    """With lanes that are not a number all of this value, so that they do not spoil the others."""
    lost = is_lost(ellipsoid)
    if not lost.any():
        return ellipsoid
    return Ellipsoid(
        np.where(lost[..., None], value, ellipsoid.centre),
        np.where(lost[..., None, None], value, ellipsoid.factor),
    )


def lose(ellipsoid: Ellipsoid, lanes: np.ndarray) -> Ellipsoid:
    """With NaN throughout in these lanes (...)."""
    if not lanes.any():
        return ellipsoid
    return Ellipsoid(
        np.where(lanes[..., None], np.nan, ellipsoid.centre),
        np.where(lanes[..., None, None], np.nan, ellipsoid.factor),
    )


def image(ellipsoid: Ellipsoid, matrix: np.ndarray) -> Ellipsoid:
    """Return the image under a linear map (..., k, n); a projection picks coordinates."""
    return Ellipsoid(multiply(matrix, ellipsoid.centre), matrix @ ellipsoid.factor)


def sum_factor(
    first: np.ndarray, second: np.ndarray, criterion: Criterion = unit_free
) -> np.ndarray:
    """Factor (..., n, r + s) of the smallest ellipsoid, by the criterion, around a sum of two.

    Of the ellipsoids (1 + b) P1 + (1 + 1/b) P2, all of which hold the sum, b^2 = tr P2 / tr P1 has
    the smallest trace (Kurzhanski and Valyi (1997), Ellipsoidal calculus, section 2.2). The weights
    of the trace are those of the root of the squared half-widths of both.
    """
    widths = [np.sqrt(squared_lengths(factor)) for factor in (first, second)]
    weights = criterion(np.hypot(*widths))
    sizes = [np.sqrt(squared_lengths(weights * width))[..., None, None] for width in widths]
    total = sizes[0] + sizes[1]
    # A point has size zero and takes no share.
    shares = [
        np.sqrt(np.divide(total, size, out=np.zeros_like(total), where=size > 0)) for size in sizes
    ]
    return join_columns(shares[0] * first, shares[1] * second)


def moved(
    ellipsoid: Ellipsoid,
    centre: np.ndarray,
    transition: np.ndarray,
    noise: np.ndarray,
    margin: np.ndarray | float = 0.0,
) -> Ellipsoid:
    """The smallest ellipsoid, free of units, around where x' = A x + B v takes it, |v| <= 1.

    Args:
        ellipsoid: of x, factor (..., n, n).
        centre: (..., n), where the plant takes the centre, known inputs included.
        transition: A (..., n, n). noise: B (..., n, q), scaled to the bound of the noise.
        margin: (..., n), half-widths of a box that comes to it.
    """
    spread = transition @ ellipsoid.factor
    reach = np.abs(ellipsoid.centre) + half_widths(ellipsoid)
    largest = magnitudes(transition, noise[..., None, :], reach) + np.abs(centre)
    rounding = rounding_bound(spread.shape[-1] + noise.shape[-1]) * largest
    return grow(Ellipsoid(centre, sum_factor(spread, noise)), rounding + margin)


def grow(
    ellipsoid: Ellipsoid,
    margin: np.ndarray,
    criterion: Criterion = unit_free,
    uncut: np.ndarray | float = 0.0,
) -> Ellipsoid:
    """An ellipsoid around the sum with the box of half-widths `margin` (..., n): factor (n, n).

    The sum of P and of n intervals m_i along the axes lies in (1 + sum q) (P + sum m_i^2 / q_i).
    With the weights w of the criterion, q_i in proportion to w_i m_i has the least trace.

    Args:
        uncut: half-widths (..., n) before readings cut the set. The weights are those of the wider:
            a state that has just become known to its rounding must not widen the others.
    """
    widths = half_widths(ellipsoid)
    weights = criterion(np.maximum(uncut, widths) + margin / _MOST_SHARE)
    box = np.vecdot(weights, margin)
    whole = np.sqrt(squared_lengths(weights * widths)) + box
    # m_i / root of q_i. Roots of both factors, as the product of small ones underflows.
    along = np.sqrt(margin) * np.sqrt(whole[..., None] / weights)
    columns = join_columns(ellipsoid.factor, along[..., None] * np.eye(margin.shape[-1]))
    growth = np.sqrt(1.0 + box / np.where(whole > 0.0, whole, 1.0))
    return Ellipsoid(ellipsoid.centre, squared(growth[..., None, None] * columns))


def squared(factor: np.ndarray) -> np.ndarray:
    """A factor (..., n, min(n, r)), lower triangular, of the same shape matrix as (..., n, r)."""
    rows, columns = factor.shape[-2:]
    # The triangle as LAPACK leaves it, with other numbers above: numpy's own masks cost as much.
    packed = np.asarray(np.linalg.qr(factor.mT, mode="raw")[0])
    kept = min(rows, columns)
    return np.where(_lower_triangle(rows, kept), packed[..., :kept], 0.0)


@functools.cache
def _lower_triangle(rows: int, columns: int) -> np.ndarray:
    return np.tri(rows, columns, dtype=bool)


def outline(ellipsoid: Ellipsoid, states: tuple[int, int], points: int = 65) -> np.ndarray:
    """Boundary (..., points, 2) of the projection onto two of the states, closed, for plots."""
    rows = list(states)
    plane = from_shape(
        ellipsoid.centre[..., rows], shape_matrix(ellipsoid)[..., rows, :][..., rows]
    )
    angles = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return plane.centre[..., None, :] + circle @ plane.factor.mT
