"""Zonotopes as sets that hold a state for certain: images of a cube, closed under sums and maps.

Where an ellipsoid must be found anew for every sum, a zonotope only gathers generators; what grows
is their number, until `reduced` boxes the smallest.
"""

from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.criterion import Criterion, unit_free
from concord.features.sets.filters.ellipsoid import Ellipsoid
from concord.features.sets.filters.rounding import rounding_bound, row_units
from concord.filters.linalg import join_columns, multiply


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


def grown(zonotope: Zonotope, margin: np.ndarray) -> Zonotope:
    """The sum with the box of half-widths `margin` (..., n): n more generators."""
    box = margin[..., None] * np.eye(margin.shape[-1])
    return Zonotope(zonotope.centre, join_columns(zonotope.generators, box))


def moved(
    zonotope: Zonotope,
    centre: np.ndarray,
    transition: np.ndarray,
    noise: np.ndarray,
    margin: np.ndarray | float = 0.0,
) -> Zonotope:
    """Where x' = A x + B v takes it, |v| <= 1; arguments as `ellipsoid.moved`."""
    spread = transition @ zonotope.generators
    reach = np.abs(zonotope.centre) + half_widths(zonotope)
    largest = multiply(np.abs(transition), reach) + np.abs(noise).sum(-1) + np.abs(centre)
    rounding = rounding_bound(spread.shape[-1] + noise.shape[-1])
    return grown(Zonotope(centre, join_columns(spread, noise)), rounding * largest + margin)


def reduced(zonotope: Zonotope, generators: int, criterion: Criterion = unit_free) -> Zonotope:
    """A zonotope around it with at most so many generators, not less than n.

    The shortest, in the weights of the criterion, give way to a box around their sum (Girard
    (2005), Reachability of uncertain linear systems using zonotopes, section 3.4; by Euclidean
    length, Combastel (2003)).
    """
    n, count = zonotope.generators.shape[-2:]
    if count <= generators:
        return zonotope
    order = np.argsort(-_squared_lengths(zonotope, criterion), axis=-1, kind="stable")
    sorted_ = np.take_along_axis(zonotope.generators, order[..., None, :], -1)
    kept, boxed = sorted_[..., : generators - n], sorted_[..., generators - n :]
    box = np.abs(boxed).sum(-1) * (1.0 + rounding_bound(count))
    return grown(Zonotope(zonotope.centre, kept), box)


def reduced_to(zonotope: Zonotope, generators: int) -> Zonotope:
    """A zonotope around it with exactly so many generators, of which some may be zero.

    Lanes with no more generators than that, zeros apart, keep them; the others are `reduced`.
    """
    count = zonotope.generators.shape[-1]
    if count <= generators:
        missing = np.zeros((*zonotope.centre.shape, generators - count))
        return Zonotope(zonotope.centre, join_columns(zonotope.generators, missing))
    lengths = _squared_lengths(zonotope, unit_free)
    few = np.count_nonzero(lengths, axis=-1) <= generators
    boxed = reduced(zonotope, generators)
    if not few.any():
        return boxed
    order = np.argsort(-lengths, axis=-1, kind="stable")[..., :generators]
    kept = np.take_along_axis(zonotope.generators, order[..., None, :], -1)
    return Zonotope(zonotope.centre, np.where(few[..., None, None], kept, boxed.generators))


def parallelotope(zonotope: Zonotope) -> Zonotope:
    """A zonotope with n generators around it: a box along its principal axes or along the state's,
    whichever is narrower in the sum of its half-widths, each in units of the zonotope's own."""
    units = row_units(half_widths(zonotope)[..., None])[..., None]
    own = zonotope.generators / units
    _, axes = np.linalg.eigh(own @ own.mT)
    lengths = np.abs(axes.mT @ own).sum(-1)
    # The axes are orthogonal but for rounding, which shows where a box is thin.
    rounding = rounding_bound(zonotope.generators.shape[-1])
    lengths = lengths + rounding * lengths.sum(-1, keepdims=True)
    turned = axes * lengths[..., None, :]
    straight = np.abs(own).sum(-1)[..., None] * np.eye(axes.shape[-1])
    narrower = np.abs(turned).sum((-1, -2)) < np.abs(straight).sum((-1, -2))
    box = np.where(narrower[..., None, None], turned, straight)
    return Zonotope(zonotope.centre, units * box)


def enclosing_ellipsoid(zonotope: Zonotope) -> Ellipsoid:
    """An ellipsoid around it: the least trace, in units of the half-widths, of its family.

    The family is the shapes sum_i g_i g_i' / w_i, sum w = 1.

    It holds because sum_i c_i g_i with |c_i| <= 1 is sum_i (c_i sqrt w_i) g_i / sqrt w_i.
    """
    lengths = np.sqrt(_squared_lengths(zonotope, unit_free))[..., None, :]
    total = lengths.sum(-1, keepdims=True)
    stretch = np.sqrt(np.divide(total, lengths, out=np.zeros_like(lengths), where=lengths > 0))
    return Ellipsoid(zonotope.centre, zonotope.generators * stretch)


def intersection(own: Zonotope, other: Zonotope) -> Zonotope:
    """A zonotope around what both hold, and not wider than `own`; generators of both together.

    Every x in both is W x + (I - W) x for any matrix W. With W = P2 (P1 + P2)^-1, where P = G G',
    the generators' squares have the least sum. Source: Combastel (2015), Zonotopes and Kalman
    observers, with a set in place of a reading. Where that is no narrower in the sum of
    half-widths, `own` stays.
    """
    units = row_units(join_columns(own.generators, other.generators))[..., None]
    first, second = own.generators / units, other.generators / units
    first, second = first @ first.mT, second @ second.mT
    weight = second @ np.linalg.pinv(first + second, hermitian=True)
    weight = units * weight / units.mT
    rest = np.eye(weight.shape[-1]) - weight
    # The difference of the centres, not the centres: those may be large and nearly equal.
    centre = own.centre + multiply(rest, other.centre - own.centre)
    both = join_columns(weight @ own.generators, rest @ other.generators)
    largest = np.abs(own.centre) + np.abs(other.centre) + half_widths(Zonotope(centre, both))
    largest = largest + multiply(np.abs(weight), half_widths(own))
    largest = largest + multiply(np.abs(rest), half_widths(other))
    narrower = grown(Zonotope(centre, both), rounding_bound(both.shape[-1]) * largest)
    return _narrower(own, narrower)


def strip_intersection(
    own: Zonotope, row: np.ndarray, value: np.ndarray, half_width: np.ndarray
) -> Zonotope:
    """The same for own and the strip |value - row x| <= half_width; row (..., n), value (...).

    Source: Bravo, Alamo, Camacho (2006), Bounded error identification of systems with time-varying
    parameters, with the weight that makes the generators' squares least.
    """
    seen = (row[..., None, :] @ own.generators)[..., 0, :]
    reach = np.abs(own.centre) + half_widths(own)
    rounding = rounding_bound(seen.shape[-1])
    width = half_width + rounding * ((np.abs(row) * reach).sum(-1) + np.abs(value))
    power = (seen**2).sum(-1) + width**2
    shared = multiply(own.generators, seen)
    gain = np.divide(
        shared, power[..., None], out=np.zeros_like(shared), where=power[..., None] > 0
    )
    centre = own.centre + gain * (value - (row * own.centre).sum(-1))[..., None]
    left = own.generators - gain[..., None] * seen[..., None, :]
    both = Zonotope(centre, join_columns(left, (gain * width[..., None])[..., None]))
    largest = reach + np.abs(gain) * ((np.abs(row) * reach).sum(-1) + np.abs(value))[..., None]
    return _narrower(own, grown(both, rounding * largest))


def gauge(zonotope: Zonotope, point: np.ndarray) -> float:
    """Least max |c_i| with centre + generators c = point (n,); at most 1 inside, inf if none is.

    One lane; a linear programme. Needs scipy, and only when called.
    """
    from scipy.optimize import linprog

    count = zonotope.generators.shape[-1]
    left, singular, right = np.linalg.svd(zonotope.generators)
    along = left.T @ (point - zonotope.centre)
    kept = np.flatnonzero(singular)
    if np.delete(along, kept).any():
        return float("inf")
    cost = np.zeros(count + 1)
    cost[-1] = 1.0
    one = np.ones((count, 1))
    # Orthonormal rows: the solver's tolerance means the same where the zonotope is thin.
    rows = np.hstack([right[kept], np.zeros((len(kept), 1))])
    found = linprog(
        cost,
        np.block([[np.eye(count), -one], [-np.eye(count), -one]]),
        np.zeros(2 * count),
        rows,
        along[kept] / singular[kept],
        bounds=(None, None),
    )
    return float(found.fun) if found.success else float("inf")


def _narrower(own: Zonotope, other: Zonotope) -> Zonotope:
    """The one with the smaller sum of half-widths, in units of those of `own`, lane by lane;
    `other` has more generators."""
    more = other.generators.shape[-1] - own.generators.shape[-1]
    stay = join_columns(own.generators, np.zeros((*other.centre.shape, more)))
    weights = unit_free(half_widths(own))
    wider = (weights * half_widths(other)).sum(-1) >= (weights * half_widths(own)).sum(-1)
    return Zonotope(
        np.where(wider[..., None], own.centre, other.centre),
        np.where(wider[..., None, None], stay, other.generators),
    )


def _squared_lengths(zonotope: Zonotope, criterion: Criterion) -> np.ndarray:
    """Of the generators (..., q), each state with its weight."""
    weights = criterion(half_widths(zonotope))[..., None]
    return ((weights * zonotope.generators) ** 2).sum(-2)
