"""Ellipsoids around what two sets both hold, for certain: how set-membership nodes fuse.

The truth lies in both sets, so it lies in their intersection, whatever was counted twice on the
way: sets need no weights against correlation. With |u|^2 <= 1 for one and |b + T u|^2 <= r^2 for
the other, every w >= 0 gives |u|^2 + w |b + T u|^2 <= 1 + w r^2, an ellipsoid. The one of least
trace is taken, each state in units of its own half-width. It has the form of covariance
intersection, with the right side that makes it certain.

Sources: Kahan (1968), Circumscribing an ellipsoid about the intersection of two ellipsoids;
Schweppe (1968); Fogel and Huang (1982), for a strip.
"""

import numpy as np

from concord.features.sets.filters.criterion import unit_free
from concord.features.sets.filters.ellipsoid import (
    Ellipsoid,
    grow,
    half_widths,
    is_lost,
    lose,
    squared,
)
from concord.features.sets.filters.rounding import rounding_bound, row_units
from concord.filters.linalg import multiply

# The weight is looked for on a grid of its logarithm, each time around the best of the last.
_GRID, _ZOOMS = 25, 4
_MARGIN = 18.0
_TIE = 1e-12


def intersection(own: Ellipsoid, other: Ellipsoid) -> Ellipsoid:
    """An ellipsoid around own and other, never larger than own (and then own itself).

    Args:
        own: factor (..., n, r). other: factor (..., n, n); one that is exactly flat is not used.

    Returns:
        factor (..., n, n); NaN in lanes in which the two have no point in common.
    """
    n = own.centre.shape[-1]
    units = row_units(other.factor)[..., None]
    triangle = squared(other.factor / units)
    flat = (np.diagonal(triangle, axis1=-2, axis2=-1) == 0).any(-1)[..., None, None]
    inverse = np.linalg.inv(np.where(flat, np.eye(n), triangle))
    # Without rows and offset nothing is cut.
    inverse = np.where(flat, 0.0, inverse)
    rows = inverse @ (own.factor / units)
    offset = multiply(inverse, (own.centre - other.centre) / units[..., 0])
    condition = np.sqrt((inverse**2).sum((-1, -2)) * (triangle**2).sum((-1, -2)))
    size = np.sqrt((rows**2).sum((-1, -2)) + (offset**2).sum(-1))
    radius = 1.0 + rounding_bound(n) * condition * (1.0 + size)
    return _narrowed(own, rows / radius[..., None, None], offset / radius[..., None])


def strip_intersection(
    own: Ellipsoid, row: np.ndarray, value: np.ndarray, half_width: np.ndarray
) -> Ellipsoid:
    """The same for own and the strip |value - row x| <= half_width.

    Args:
        own: centre (..., n). row: (..., n). value, half_width: (...).
    """
    reach = np.abs(own.centre) + half_widths(own)
    rounding = rounding_bound(own.centre.shape[-1] + own.factor.shape[-1])
    moved = rounding * ((np.abs(row) * reach).sum(-1) + np.abs(value))
    radius = (half_width + moved + np.finfo(float).tiny)[..., None]
    offset = ((row * own.centre).sum(-1) - value)[..., None]
    rows = row[..., None, :] @ own.factor
    return _narrowed(own, rows / radius[..., None], offset / radius)


def _narrowed(own: Ellipsoid, rows: np.ndarray, offset: np.ndarray) -> Ellipsoid:
    """Around the points centre + factor u with |u| <= 1 and |offset + rows u| <= 1."""
    left, singular, right = np.linalg.svd(rows, full_matrices=True)
    turned = own.factor @ right.mT
    count = singular.shape[-1]
    stretch, shift = np.zeros(turned[..., 0, :].shape), np.zeros(turned[..., 0, :].shape)
    along = multiply(left.mT, offset)
    stretch[..., :count], shift[..., :count] = singular, along[..., :count]
    beyond = (along[..., count:] ** 2).sum(-1)
    relative = turned / row_units(own.factor)[..., None]
    weight = _best_weight(stretch**2, shift**2, beyond, (relative**2).sum(-2))
    eigenvalues = 1.0 + weight[..., None] * stretch**2
    room = _room(weight, stretch**2, shift**2, beyond)
    # The room grows by the error that rounding may have caused in the eigenvectors and in itself.
    spread = eigenvalues.max(-1) / eigenvalues.min(-1)
    rounding = rounding_bound(own.centre.shape[-1] + turned.shape[-1])
    room = (room + rounding * (1.0 + weight)) * (1.0 + rounding * spread)
    room = np.where(room > 0, room, np.nan)
    factor = turned * np.sqrt(room[..., None] / eigenvalues)[..., None, :]
    centre = own.centre - multiply(turned, weight[..., None] * stretch * shift / eigenvalues)
    widths = half_widths(own)
    margin = np.broadcast_to(rounding * (np.abs(own.centre) + widths), centre.shape)
    narrowed = grow(Ellipsoid(centre, factor), margin, uncut=widths)
    square = own.factor.shape[-1] == centre.shape[-1]
    same = own if square else grow(own, margin)
    weights = unit_free(widths)
    worse = ((weights * half_widths(narrowed)) ** 2).sum(-1) >= ((weights * widths) ** 2).sum(-1)
    chosen = Ellipsoid(
        np.where(worse[..., None], own.centre, narrowed.centre),
        np.where(worse[..., None, None], same.factor, narrowed.factor),
    )
    return lose(chosen, is_lost(chosen))


def _room(
    weight: np.ndarray, squares: np.ndarray, shifts: np.ndarray, beyond: np.ndarray
) -> np.ndarray:
    """1 + w - min over u of |u|^2 + w |b + T u|^2: negative where the sets share nothing."""
    taken = beyond + (shifts / (1.0 + weight[..., None] * squares)).sum(-1)
    return 1.0 + weight * (1.0 - taken)


def _best_weight(
    squares: np.ndarray, shifts: np.ndarray, beyond: np.ndarray, sizes: np.ndarray
) -> np.ndarray:
    """w (...) at which room times sum sizes / (1 + w squares), the trace, is least.

    Quasi-convex in w, so that zooming in finds it: the trace is a convex function of the two
    multipliers, of degree -1, times one of degree 1.
    """
    largest = squares.max(-1)
    least = np.where(squares > 0, squares, np.inf).min(-1)
    least = np.where(np.isfinite(least), least, 1.0)
    low = -_MARGIN - np.log1p(largest)
    high = _MARGIN + np.log1p(1.0 / np.maximum(least, np.finfo(float).tiny))
    for _ in range(_ZOOMS):
        middle, spacing = _best_of_grid(low, high, squares, shifts, beyond, sizes)
        low, high = middle - spacing, middle + spacing
    return np.exp(0.5 * (low + high))


def _best_of_grid(
    low: np.ndarray,
    high: np.ndarray,
    squares: np.ndarray,
    shifts: np.ndarray,
    beyond: np.ndarray,
    sizes: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The logarithm of the best weight (...) of a grid, and the spacing (...) of the grid."""
    spacing = (high - low)[..., None] / (_GRID - 1)
    grid = low[..., None] + spacing * np.arange(_GRID)
    weights = np.exp(grid)
    at = 1.0 + weights[..., None] * squares[..., None, :]
    room = _room(weights, squares[..., None, :], shifts[..., None, :], beyond[..., None])
    traces = room * (sizes[..., None, :] / at).sum(-1)
    traces = np.where(np.isnan(traces), np.inf, traces)
    least = traces.min(axis=-1, keepdims=True)
    # Two sets that are nearly one have the same trace for every weight: the least weight is taken,
    # and not the one that rounding favours.
    best = np.argmax(traces <= least + _TIE * np.abs(least), axis=-1)[..., None]
    return np.take_along_axis(grid, best, -1)[..., 0], spacing[..., 0]
