"""Ellipsoids around what two sets both hold, for certain: how set-membership nodes fuse.

The truth lies in both sets, so it lies in their intersection, whatever was counted twice on the
way: sets need no weights against correlation. With |u|^2 <= 1 for one and |b + T u|^2 <= r^2 for
the other, every w >= 0 gives |u|^2 + w |b + T u|^2 <= 1 + w r^2, an ellipsoid. The one of least
trace is taken, each state in units of its own half-width. It has the form of covariance
intersection, with the right side that makes it certain.

Sources: Kahan (1968), Circumscribing an ellipsoid about the intersection of two ellipsoids;
Schweppe (1968); Fogel and Huang (1982), for a strip.
"""

from typing import NamedTuple

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

# The weight is looked for on a grid of its logarithm, each time around the best of the last, and
# then where the slope of the trace is zero.
_GRID, _ZOOMS, _SECANTS = 25, 4, 4
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


class _Cut(NamedTuple):
    """|u|^2 <= 1 and |b + T u|^2 <= 1 along the singular vectors of T.

    Squares (..., r) of singular values and of the offset b along them, the rest of |b|^2 (...), and
    the squared lengths (..., r) of the first ellipsoid's axes, each state in its own units.
    """

    squares: np.ndarray
    shifts: np.ndarray
    beyond: np.ndarray
    sizes: np.ndarray

    def for_weights(self) -> "_Cut":
        """Return the same for weights (..., k) in place of (...)."""
        squares, shifts, sizes = (
            one[..., None, :] for one in (self.squares, self.shifts, self.sizes)
        )
        return _Cut(squares, shifts, self.beyond[..., None], sizes)

    def room(self, weight: np.ndarray) -> np.ndarray:
        """1 + w - min over u of |u|^2 + w |b + T u|^2: negative where the sets share nothing."""
        taken = self.beyond + (self.shifts / (1.0 + weight[..., None] * self.squares)).sum(-1)
        return 1.0 + weight * (1.0 - taken)

    def trace(self, weight: np.ndarray) -> np.ndarray:
        """Return the trace of the ellipsoid around both."""
        return self.room(weight) * (self.sizes / (1.0 + weight[..., None] * self.squares)).sum(-1)

    def slope(self, logarithm: np.ndarray) -> np.ndarray:
        """Return the derivative of the logarithm of the trace by that of the weight."""
        weight = np.exp(logarithm)
        at = 1.0 + weight[..., None] * self.squares
        more = (self.shifts * self.squares / at**2).sum(-1)
        rise = 1.0 - self.beyond - (self.shifts / at).sum(-1) + weight * more
        fall = (self.sizes * self.squares / at**2).sum(-1) / (self.sizes / at).sum(-1)
        return weight * (rise / self.room(weight) - fall)


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
    cut = _Cut(stretch**2, shift**2, beyond, (relative**2).sum(-2))
    weight = _best_weight(cut)
    eigenvalues = 1.0 + weight[..., None] * stretch**2
    room = cut.room(weight)
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


def _best_weight(cut: _Cut) -> np.ndarray:
    """w (...) at which the trace is least.

    Quasi-convex in w, so that zooming in finds it: the trace is a convex function of the two
    multipliers, of degree -1, times one of degree 1.
    """
    largest = cut.squares.max(-1)
    least = np.where(cut.squares > 0, cut.squares, np.inf).min(-1)
    least = np.where(np.isfinite(least), least, 1.0)
    low = -_MARGIN - np.log1p(largest)
    high = _MARGIN + np.log1p(1.0 / np.maximum(least, np.finfo(float).tiny))
    for _ in range(_ZOOMS):
        middle, spacing = _best_of_grid(low, high, cut)
        low, high = middle - spacing, middle + spacing
    return np.exp(_flat_point(low, high, cut))


def _best_of_grid(low: np.ndarray, high: np.ndarray, cut: _Cut) -> tuple[np.ndarray, np.ndarray]:
    """The logarithm of the best weight (...) of a grid, and the spacing (...) of the grid."""
    spacing = (high - low)[..., None] / (_GRID - 1)
    grid = low[..., None] + spacing * np.arange(_GRID)
    traces = cut.for_weights().trace(np.exp(grid))
    traces = np.where(np.isnan(traces), np.inf, traces)
    least = traces.min(axis=-1, keepdims=True)
    # Two sets that are nearly one have the same trace for every weight: the least weight is taken,
    # and not the one that rounding favours.
    best = np.argmax(traces <= least + _TIE * np.abs(least), axis=-1)[..., None]
    return np.take_along_axis(grid, best, -1)[..., 0], spacing[..., 0]


def _flat_point(low: np.ndarray, high: np.ndarray, cut: _Cut) -> np.ndarray:
    """Logarithm (...) of the weight between two, at which the trace has no slope; their middle
    where the slope does not rise.

    A grid alone would let rounding choose one of two neighbours that are equally good.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        before, of_before = low, cut.slope(low)
        found, of_found = high, cut.slope(high)
        rises = (of_before < 0) & (of_found > 0)
        for _ in range(_SECANTS):
            step = of_found * (found - before) / (of_found - of_before)
            # At the root, slopes are rounding: a step that is longer than the last is none.
            is_step = np.abs(step) < np.abs(found - before)
            before, of_before = found, of_found
            found = np.clip(found - np.where(is_step, step, 0.0), low, high)
            of_found = cut.slope(found)
    return np.where(rises, found, 0.5 * (low + high))
