"""Ellipsoids as sets that hold a state for certain, and what keeps them so in floating point.

An ellipsoid is kept as its centre and a factor, never as an inverse shape: a flat one (a state that
is known exactly in some direction) is as good as any other. Whoever computes a new ellipsoid grows
it by a bound on its own rounding (`rounding_bound`, `grow`), so that it holds the true state and
not only the state of exact arithmetic.
"""

import math
from typing import NamedTuple

import numpy as np

from filters.lanes import join_columns
from filters.linalg import multiply

UNIT_ROUNDOFF = 2.0**-53


class Ellipsoid(NamedTuple):
    """{centre + factor u : |u| <= 1} per lane: centre (..., n), factor (..., n, r), any r >= 1.

    Its shape matrix is P = factor factor'; where P can be inverted the set is e' P^-1 e <= 1.
    """

    centre: np.ndarray
    factor: np.ndarray


def from_shape(centre: np.ndarray, shape: np.ndarray) -> Ellipsoid:
    """The ellipsoid with a shape matrix (..., n, n), which may be singular; factor (..., n, n)."""
    values, vectors = np.linalg.eigh(shape)
    return Ellipsoid(centre, vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def shape_matrix(ellipsoid: Ellipsoid) -> np.ndarray:
    """P (..., n, n)."""
    return ellipsoid.factor @ ellipsoid.factor.mT


def half_widths(ellipsoid: Ellipsoid) -> np.ndarray:
    """Largest distance (..., n) from the centre along each axis: the roots of P's diagonal."""
    return np.sqrt((ellipsoid.factor**2).sum(-1))


def squared_radius(ellipsoid: Ellipsoid, point: np.ndarray) -> np.ndarray:
    """|u|^2 (...) of the shortest u with centre + factor u = point (..., n): e' P^+ e.

    At most 1 inside. A direction in which the ellipsoid is exactly flat admits no deviation, not
    even one of rounding: infinite there.
    """
    left, singular, _ = np.linalg.svd(ellipsoid.factor, full_matrices=True)
    along = multiply(left.mT, point - ellipsoid.centre)
    flat = np.zeros(along.shape)
    flat[..., : singular.shape[-1]] = singular
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.where((flat == 0.0) & (along == 0.0), 0.0, along / flat)
        return (ratio**2).sum(-1)


def image(ellipsoid: Ellipsoid, matrix: np.ndarray) -> Ellipsoid:
    """What a linear map (..., k, n) makes of it; a projection picks coordinates."""
    return Ellipsoid(multiply(matrix, ellipsoid.centre), matrix @ ellipsoid.factor)


def sum_factor(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Factor (..., n, r + s) of the smallest ellipsoid, by trace, around a sum of two.

    Of the ellipsoids (1 + b) P1 + (1 + 1/b) P2, all of which hold the sum, b^2 = tr P2 / tr P1 has
    the smallest trace (Kurzhanski and Valyi (1997), Ellipsoidal calculus, section 2.2).
    """
    size = np.sqrt((first**2).sum((-1, -2)))[..., None, None]
    other = np.sqrt((second**2).sum((-1, -2)))[..., None, None]
    total = size + other
    # A point has size zero and takes no share.
    share = np.sqrt(np.divide(total, size, out=np.zeros_like(size), where=size > 0))
    other_share = np.sqrt(np.divide(total, other, out=np.zeros_like(other), where=other > 0))
    return join_columns(share * first, other_share * second)


def grow(ellipsoid: Ellipsoid, margin: np.ndarray) -> Ellipsoid:
    """An ellipsoid around the sum with the box of half-widths `margin` (..., n): factor (n, n)."""
    n = margin.shape[-1]
    # The smallest ellipsoid around a box has its half-widths times the root of n.
    box = math.sqrt(n) * margin[..., None] * np.eye(n)
    return Ellipsoid(ellipsoid.centre, squared(sum_factor(ellipsoid.factor, box)))


def squared(factor: np.ndarray) -> np.ndarray:
    """A factor (..., n, min(n, r)), lower triangular, of the same shape matrix as (..., n, r)."""
    return np.linalg.qr(factor.mT, mode="r").mT


def outline(ellipsoid: Ellipsoid, states: tuple[int, int], points: int = 65) -> np.ndarray:
    """Boundary (..., points, 2) of the projection onto two of the states, closed, for plots."""
    rows = list(states)
    plane = from_shape(
        ellipsoid.centre[..., rows], shape_matrix(ellipsoid)[..., rows, :][..., rows]
    )
    angles = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return plane.centre[..., None, :] + circle @ plane.factor.mT


def rounding_bound(terms: int) -> float:
    """Relative error of everything that a step computes from sums of `terms` products.

    One such sum is off by at most terms * 2^-53 times the sum of the absolute products (Higham
    (2002), Accuracy and stability of numerical algorithms, section 3.1). The truth is computed with
    rounding too, and a step is a chain of a few such sums: eight times that holds all of them.
    """
    return 8 * terms * UNIT_ROUNDOFF
