"""Ellipsoids: membership, sums, growth, and intersections that never lose a common point."""

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from concord.features.sets.filters.criterion import plain_trace, unit_free
from concord.features.sets.filters.ellipsoid import (
    Ellipsoid,
    from_shape,
    grow,
    half_widths,
    image,
    lose,
    moved,
    outline,
    shape_matrix,
    squared,
    squared_radius,
    sum_factor,
)
from concord.features.sets.filters.ellipsoid_intersection import intersection, strip_intersection

SEEDS = st.integers(0, 2**32 - 1)


def random_ellipsoid(rng: np.random.Generator, n: int, lanes: tuple[int, ...] = ()) -> Ellipsoid:
    """Axes that differ by some orders of magnitude."""
    lengths = 10.0 ** rng.uniform(-2, 1, (*lanes, 1, n))
    return Ellipsoid(
        rng.standard_normal((*lanes, n)), rng.standard_normal((*lanes, n, n)) * lengths
    )


def on_the_edge(rng: np.random.Generator, one: Ellipsoid) -> np.ndarray:
    u = rng.standard_normal(one.factor.shape[-1])
    return one.centre + one.factor @ (u / np.linalg.norm(u))


def around(rng: np.random.Generator, point: np.ndarray, depth: float) -> Ellipsoid:
    """An ellipsoid in which the point is at squared radius depth^2."""
    one = random_ellipsoid(rng, len(point))
    edge = on_the_edge(rng, Ellipsoid(np.zeros_like(point), one.factor))
    return Ellipsoid(point - depth * edge, one.factor)


@settings(max_examples=30)
@example(seed=1203, n=5)
@given(seed=SEEDS, n=st.integers(1, 5))
def test_squared_radius_is_the_quadratic_form(seed: int, n: int):
    rng = np.random.default_rng(seed)
    one = random_ellipsoid(rng, n, (3,))
    points = rng.standard_normal((3, n))
    error = (points - one.centre)[..., None]
    # e' (F F')^-1 e = |F^-1 e|^2: the shape matrix itself would square the condition of its factor.
    unit = np.linalg.solve(one.factor, error)
    form = (unit.mT @ unit)[..., 0, 0]
    np.testing.assert_allclose(squared_radius(one, points), form, rtol=1e-6)


def test_a_flat_ellipsoid_holds_its_plane_and_nothing_beside_it():
    flat = Ellipsoid(np.array([1.0, 2.0, 3.0]), np.array([[2.0, 0.0], [0.0, 1.0], [0.0, 0.0]]))
    assert squared_radius(flat, np.array([2.0, 2.5, 3.0])) == pytest.approx(0.5)
    assert squared_radius(flat, np.array([1.0, 2.0, 3.0])) == 0.0
    assert squared_radius(flat, np.array([1.0, 2.0, 3.0 + 1e-12])) == np.inf
    grown = grow(flat, np.full(3, 1e-12))
    assert squared_radius(grown, np.array([2.0, 2.5, 3.0 + 1e-12])) <= 1


@settings(max_examples=30)
@given(seed=SEEDS, n=st.integers(1, 4))
def test_the_sum_holds_every_sum_and_has_the_least_trace(seed: int, n: int):
    rng = np.random.default_rng(seed)
    first, second = rng.standard_normal((n, n)), rng.standard_normal((n, 2))
    both = Ellipsoid(np.zeros(n), sum_factor(first, second, plain_trace))
    for _ in range(20):
        point = on_the_edge(rng, Ellipsoid(np.zeros(n), first))
        point = on_the_edge(rng, Ellipsoid(point, second))
        assert squared_radius(both, point) <= 1 + 1e-9
    p1, p2 = first @ first.T, second @ second.T
    family = [(1 + b) * p1 + (1 + 1 / b) * p2 for b in np.logspace(-3, 3, 200)]
    assert np.trace(shape_matrix(both)) <= min(map(np.trace, family)) + 1e-12
    # The same in units of the half-widths of both.
    own = sum_factor(first, second)
    square = 1.0 / np.diag(p1 + p2)
    least = min(float(square @ np.diag(one)) for one in family)
    assert square @ np.diag(own @ own.T) <= least + 1e-12


def test_a_sum_with_a_point_adds_nothing():
    factor = np.diag([1.0, 2.0])
    np.testing.assert_allclose(
        squared(sum_factor(factor, np.zeros((2, 1)))) ** 2, factor**2, atol=1e-15
    )


@settings(max_examples=30)
@given(seed=SEEDS, n=st.integers(1, 4))
def test_growth_holds_the_box_around_every_point(seed: int, n: int):
    rng = np.random.default_rng(seed)
    one = random_ellipsoid(rng, n)
    margin = 10.0 ** rng.uniform(-6, 0, n)
    corner = on_the_edge(rng, one) + margin * rng.choice([-1.0, 1.0], n)
    assert squared_radius(grow(one, margin), corner) <= 1 + 1e-9


@settings(max_examples=30)
@given(seed=SEEDS, n=st.integers(1, 4), scale=st.integers(0, 12))
def test_a_moved_ellipsoid_holds_the_moved_state_however_large(seed: int, n: int, scale: int):
    rng = np.random.default_rng(seed)
    one = random_ellipsoid(rng, n)
    one = one._replace(centre=one.centre * 10.0**scale)
    transition, noise = rng.standard_normal((n, n)), rng.standard_normal((n, 2))
    v = rng.standard_normal(2)
    truth = transition @ on_the_edge(rng, one) + noise @ (v / np.linalg.norm(v))
    after = moved(one, transition @ one.centre, transition, noise)
    assert squared_radius(after, truth) <= 1


def test_half_widths_are_the_largest_coordinates_and_outlines_touch_them():
    one = random_ellipsoid(np.random.default_rng(3), 3)
    points = outline(one, (2, 0), points=4001)
    np.testing.assert_allclose(points[0], points[-1])
    reach = np.abs(points - one.centre[[2, 0]]).max(0)
    np.testing.assert_allclose(reach, half_widths(one)[[2, 0]], rtol=1e-4)
    plane = image(one, np.eye(3)[[2, 0]])
    np.testing.assert_allclose(squared_radius(plane, points), 1.0, rtol=1e-9)


def test_from_shape_takes_singular_shapes_as_they_are():
    shape = np.array([[4.0, 2.0], [2.0, 1.0]])
    np.testing.assert_allclose(shape_matrix(from_shape(np.zeros(2), shape)), shape, atol=1e-14)


# --- intersections -------------------------------------------------------------------------------


@settings(max_examples=80)
@given(
    seed=SEEDS,
    n=st.integers(1, 4),
    own_depth=st.floats(0, 1 - 1e-12),
    other_depth=st.floats(0, 1 - 1e-12),
)
def test_no_common_point_is_lost(seed: int, n: int, own_depth: float, other_depth: float):
    rng = np.random.default_rng(seed)
    truth = rng.standard_normal(n) * 10.0 ** rng.uniform(-3, 4)
    own, other = around(rng, truth, own_depth), around(rng, truth, other_depth)
    # A small set far from the origin may have its own edge rounded past the truth.
    assume(max(squared_radius(own, truth), squared_radius(other, truth)) <= 1)
    both = intersection(own, other)
    assert squared_radius(both, truth) <= 1
    weights = unit_free(half_widths(own))
    assert ((weights * half_widths(both)) ** 2).sum() <= n * (1 + 1e-12)
    row, half_width = rng.standard_normal(n), 10.0 ** rng.uniform(-6, 1)
    cut = strip_intersection(own, row, row @ truth + other_depth * half_width, half_width)
    assert squared_radius(cut, truth) <= 1
    assert ((weights * half_widths(cut)) ** 2).sum() <= n * (1 + 1e-12)


def test_an_intersection_changes_as_little_as_its_sets():
    """Drivers round differently: the last digit of a set must not decide between weights."""
    radius = np.linspace(0.85, 0.87, 100_001)
    lanes = len(radius)
    ball = Ellipsoid(np.zeros((lanes, 2)), np.broadcast_to(np.eye(2), (lanes, 2, 2)))
    other = Ellipsoid(ball.centre + np.array([1.0, 0.3]), radius[:, None, None] * ball.factor)
    widths = half_widths(intersection(ball, other))
    assert np.abs(np.diff(widths, 2, axis=0)).max() < 1e-11


@pytest.mark.parametrize("n", [2, 4])
def test_rounding_moves_an_intersection_by_rounding(n: int):
    rng = np.random.default_rng(n)
    factors = np.eye(n) + 0.4 * rng.standard_normal((2, 20_000, n, n))
    offsets = 0.2 * rng.standard_normal((2, 20_000, n))
    own, other = (Ellipsoid(*one) for one in zip(offsets, factors, strict=True))
    last = 1 + np.finfo(float).eps * rng.integers(-1, 2, factors[1].shape)
    near = Ellipsoid(other.centre, other.factor * last)
    off = half_widths(intersection(own, other)) / half_widths(intersection(own, near)) - 1
    sound = np.linalg.cond(factors).max(axis=0) < 100
    assert np.nanmax(np.abs(off[sound])) < 1e-10


@settings(max_examples=15)
@given(seed=SEEDS, n=st.integers(1, 3))
def test_the_intersection_has_the_least_trace_of_its_family(seed: int, n: int):
    # The convex combinations, written in the usual form with inverses (Kahan).
    rng = np.random.default_rng(seed)
    truth = rng.standard_normal(n)
    own, other = around(rng, truth, 0.9), around(rng, truth, 0.9)
    a, b = np.linalg.inv(shape_matrix(own)), np.linalg.inv(shape_matrix(other))
    weights = unit_free(half_widths(own))

    def trace(log_odds: float) -> float:
        share = 1 / (1 + np.exp(-log_odds))
        x = (1 - share) * a + share * b
        c = np.linalg.solve(x, (1 - share) * a @ own.centre + share * b @ other.centre)
        d, e = own.centre - c, other.centre - c
        room = 1 - (1 - share) * d @ a @ d - share * e @ b @ e
        return float(room * (weights**2 @ np.diag(np.linalg.inv(x))))

    grid = np.linspace(-18, 18, 200)
    best = grid[int(np.argmin([trace(one) for one in grid]))]
    found = minimize_scalar(trace, bounds=(best - 0.4, best + 0.4), options={"xatol": 1e-7})
    least = min(float(found.fun), float(n))  # pyright: ignore[reportAttributeAccessIssue]
    both = half_widths(intersection(own, other))
    assert ((weights * both) ** 2).sum() == pytest.approx(least, rel=1e-4)


def test_sets_without_a_common_point_are_lost_and_alone():
    own = Ellipsoid(np.zeros((2, 2)), np.broadcast_to(np.eye(2), (2, 2, 2)))
    other = Ellipsoid(np.array([[2.5, 0.0], [1.5, 0.0]]), own.factor)
    both = intersection(own, other)
    assert np.isnan(both.factor[0]).all()
    assert np.isfinite(both.factor[1]).all()
    alone = intersection(Ellipsoid(own.centre[1], own.factor[1]), Ellipsoid(*(p[1] for p in other)))
    np.testing.assert_allclose(both.factor[1], alone.factor, rtol=1e-12)
    apart = strip_intersection(own, np.array([1.0, 0.0]), np.array(1.2), np.array(0.1))
    assert np.isnan(apart.factor).all()


def test_an_exactly_flat_neighbour_is_not_used():
    own = Ellipsoid(np.zeros(2), np.eye(2))
    flat = Ellipsoid(np.zeros(2), np.diag([1.0, 0.0]))
    np.testing.assert_allclose(shape_matrix(intersection(own, flat)), np.eye(2), rtol=1e-9)


def test_lost_lanes_stay_lost_and_hurt_nobody():
    one = random_ellipsoid(np.random.default_rng(1), 3, (2,))
    hurt = lose(one, np.array([True, False]))
    values = squared_radius(hurt, one.centre + 0.1)
    assert np.isnan(values[0])
    assert values[1] == squared_radius(one, one.centre + 0.1)[1]
