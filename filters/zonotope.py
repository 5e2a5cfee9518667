"""Zonotopes as sets that hold a state for certain: images of a cube, closed under sums and maps.

Where an ellipsoid must be found anew for every sum, a zonotope only gathers generators; what grows
is their number, until `reduced` boxes the smallest.
"""

from typing import NamedTuple

import numpy as np

from filters.ellipsoid import Ellipsoid
from filters.linalg import multiply


class Zonotope(NamedTuple):
    """{centre + generators c : |c_i| <= 1} per lane: centre (..., n), generators (..., n, q)."""

    centre: np.ndarray
    generators: np.ndarray


def half_widths(zonotope: Zonotope) -> np.ndarray:
    """Largest distance (..., n) from the centre along each axis."""
    return np.abs(zonotope.generators).sum(-1)


def around(ellipsoid: Ellipsoid) -> Zonotope:
    """A zonotope that holds an ellipsoid: the unit ball lies in the cube."""
    return Zonotope(ellipsoid.centre, ellipsoid.factor)


def reduced(zonotope: Zonotope, generators: int) -> Zonotope:
    """A zonotope around it with at most so many generators, not less than n.

    The shortest give way to a box around their sum (Girard (2005), Reachability of uncertain linear
    systems using zonotopes, section 3.4; by Euclidean length, Combastel (2003)).
    """
    n, count = zonotope.generators.shape[-2:]
    if count <= generators:
        return zonotope
    order = np.argsort(-(zonotope.generators**2).sum(-2), axis=-1, kind="stable")
    sorted_ = np.take_along_axis(zonotope.generators, order[..., None, :], -1)
    kept, boxed = sorted_[..., : generators - n], sorted_[..., generators - n :]
    box = np.abs(boxed).sum(-1)[..., None] * np.eye(n)
    return Zonotope(zonotope.centre, np.concatenate([kept, box], axis=-1))


def parallelotope(zonotope: Zonotope) -> Zonotope:
    """A zonotope with n generators around it: a box along its principal axes or along the state's,
    whichever is narrower in the sum of its half-widths."""
    _, axes = np.linalg.eigh(zonotope.generators @ zonotope.generators.mT)
    lengths = np.abs(axes.mT @ zonotope.generators).sum(-1)
    turned = axes * lengths[..., None, :]
    straight = half_widths(zonotope)[..., None] * np.eye(axes.shape[-1])
    narrower = np.abs(turned).sum((-1, -2)) < np.abs(straight).sum((-1, -2))
    return Zonotope(zonotope.centre, np.where(narrower[..., None, None], turned, straight))


def enclosing_ellipsoid(zonotope: Zonotope) -> Ellipsoid:
    """An ellipsoid around it, of least trace among those with shape sum_i g_i g_i' / w_i, sum w = 1.

    It holds because sum_i c_i g_i with |c_i| <= 1 is sum_i (c_i sqrt w_i) g_i / sqrt w_i.
    """
    lengths = np.sqrt((zonotope.generators**2).sum(-2, keepdims=True))
    total = lengths.sum(-1, keepdims=True)
    stretch = np.sqrt(np.divide(total, lengths, out=np.zeros_like(lengths), where=lengths > 0))
    return Ellipsoid(zonotope.centre, zonotope.generators * stretch)


def intersection(own: Zonotope, other: Zonotope) -> Zonotope:
    """A zonotope around what both hold, and not wider than `own`; generators of both together.

    Every x in both is W x + (I - W) x for any matrix W; with W = P2 (P1 + P2)^-1, where P = G G', the
    generators' squares have the least sum (Combastel (2015), Zonotopes and Kalman observers, with a
    set in place of a reading). Where that is no narrower in the sum of half-widths, `own` stays.
    """
    first = own.generators @ own.generators.mT
    second = other.generators @ other.generators.mT
    weight = second @ np.linalg.pinv(first + second, hermitian=True)
    rest = np.eye(weight.shape[-1]) - weight
    centre = multiply(weight, own.centre) + multiply(rest, other.centre)
    generators = np.concatenate([weight @ own.generators, rest @ other.generators], axis=-1)
    wider = np.abs(generators).sum((-1, -2)) >= np.abs(own.generators).sum((-1, -2))
    padding = np.zeros(other.generators.shape)
    stay = np.concatenate([own.generators, padding], axis=-1)
    return Zonotope(
        np.where(wider[..., None], own.centre, centre),
        np.where(wider[..., None, None], stay, generators),
    )


def gauge(zonotope: Zonotope, point: np.ndarray) -> float:
    """Least max |c_i| with centre + generators c = point (n,); at most 1 inside, inf if none is.

    One lane; a linear programme. Needs scipy, and only when called.
    """
    from scipy.optimize import linprog

    n, count = zonotope.generators.shape
    cost = np.zeros(count + 1)
    cost[-1] = 1.0
    one = np.ones((count, 1))
    limits = np.block([[np.eye(count), -one], [-np.eye(count), -one]])
    equations = np.hstack([zonotope.generators, np.zeros((n, 1))])
    found = linprog(
        cost, limits, np.zeros(2 * count), equations, point - zonotope.centre, bounds=(None, None)
    )
    return float(found.fun) if found.success else float("inf")
