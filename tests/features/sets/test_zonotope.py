"""Zonotopes: what holds a point holds it through reduction, maps, cuts and intersections."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from concord.features.sets.filters.ellipsoid import Ellipsoid, squared_radius
from concord.features.sets.filters.zonotope import (
    Zonotope,
    around,
    enclosing_ellipsoid,
    gauge,
    half_widths,
    intersection,
    moved,
    parallelotope,
    reduced,
    strip_intersection,
)

SEEDS = st.integers(0, 2**32 - 1)


def random_zonotope(rng: np.random.Generator, n: int, q: int) -> Zonotope:
    lengths = 10.0 ** rng.uniform(-2, 0.5, q)
    return Zonotope(rng.standard_normal(n), rng.standard_normal((n, q)) * lengths)


def corner(rng: np.random.Generator, one: Zonotope) -> np.ndarray:
    """A point with coefficients at their ends: as far out as a zonotope goes."""
    return one.centre + one.generators @ rng.choice([-1.0, 1.0], one.generators.shape[-1])


def moved_to(rng: np.random.Generator, one: Zonotope, truth: np.ndarray) -> Zonotope:
    """The same zonotope with the truth at a random one of its corners."""
    return Zonotope(one.centre + truth - corner(rng, one), one.generators)


@settings(max_examples=30)
@given(seed=SEEDS, n=st.integers(1, 4))
def test_what_is_made_of_it_holds_its_corners(seed: int, n: int):
    rng = np.random.default_rng(seed)
    one = random_zonotope(rng, n, 3 * n + 2)
    point = corner(rng, one)
    assert gauge(one, point) <= 1 + 1e-9
    assert gauge(reduced(one, n + 1), point) <= 1 + 1e-9
    assert gauge(parallelotope(one), point) <= 1 + 1e-9
    assert squared_radius(enclosing_ellipsoid(one), point) <= 1 + 1e-9
    assert (np.abs(point - one.centre) <= half_widths(one) * (1 + 1e-12)).all()


@settings(max_examples=30)
@given(seed=SEEDS, n=st.integers(1, 4), scale=st.integers(0, 12))
def test_a_moved_zonotope_holds_the_moved_state_however_large(seed: int, n: int, scale: int):
    rng = np.random.default_rng(seed)
    one = random_zonotope(rng, n, n + 2)
    one = one._replace(centre=one.centre * 10.0**scale)
    transition, noise = rng.standard_normal((n, n)), rng.standard_normal((n, 2))
    v = rng.standard_normal(2)
    truth = transition @ corner(rng, one) + noise @ (v / np.linalg.norm(v))
    after = moved(one, transition @ one.centre, transition, noise)
    assert gauge(after, truth) <= 1 + 1e-9


@settings(max_examples=40)
@given(seed=SEEDS, n=st.integers(1, 4))
def test_no_common_point_is_lost_and_nothing_gets_wider(seed: int, n: int):
    rng = np.random.default_rng(seed)
    truth = rng.standard_normal(n) * 10.0 ** rng.uniform(-3, 4)
    own = moved_to(rng, random_zonotope(rng, n, n + 3), truth)
    other = moved_to(rng, random_zonotope(rng, n, n), truth)
    both = intersection(own, other)
    assert gauge(both, truth) <= 1 + 1e-6
    assert (half_widths(both) / half_widths(own)).sum() <= n * (1 + 1e-12)
    row, half_width = rng.standard_normal(n), 10.0 ** rng.uniform(-6, 1)
    cut = strip_intersection(own, row, row @ truth + half_width, np.array(half_width))
    assert gauge(cut, truth) <= 1 + 1e-6
    assert (half_widths(cut) / half_widths(own)).sum() <= n * (1 + 1e-12)


def test_a_ball_lies_in_its_cube():
    one = around(Ellipsoid(np.ones(2), np.eye(2)))
    np.testing.assert_array_equal(half_widths(one), [1.0, 1.0])


def test_few_generators_are_left_alone():
    one = random_zonotope(np.random.default_rng(0), 2, 5)
    assert reduced(one, 5) is one
    assert reduced(one, 4).generators.shape == (2, 4)


def test_a_narrow_strip_cuts_to_its_width():
    square = Zonotope(np.zeros(2), np.eye(2))
    cut = strip_intersection(square, np.array([1.0, 0.0]), np.array(0.5), np.array(1e-3))
    np.testing.assert_allclose(half_widths(cut), [1e-3, 1.0], rtol=1e-3)
    np.testing.assert_allclose(cut.centre, [0.5, 0.0], atol=1e-3)


def test_lanes_are_independent():
    rng = np.random.default_rng(5)
    lanes = [random_zonotope(rng, 3, 7) for _ in range(4)]
    together = Zonotope(*(np.array(parts) for parts in zip(*lanes, strict=True)))
    for i, alone in enumerate(lanes):
        lane = reduced(together, 5)
        np.testing.assert_array_equal(lane.generators[i], reduced(alone, 5).generators)
        box = parallelotope(together).generators[i]
        np.testing.assert_allclose(box, parallelotope(alone).generators, rtol=1e-12)
        pair = intersection(together, together)
        np.testing.assert_allclose(
            half_widths(Zonotope(pair.centre[i], pair.generators[i])), half_widths(alone), rtol=1e-9
        )


def test_an_intersection_has_the_least_squares_of_all_weights():
    """A search over all matrices W in W x + (I - W) x finds nothing smaller."""
    rng = np.random.default_rng(2)
    flat, tall = np.diag([3.0, 0.2]), np.diag([0.3, 2.0])
    own = Zonotope(np.zeros(2), np.hstack((flat, 0.1 * rng.standard_normal((2, 2)))))
    other = Zonotope(np.full(2, 0.05), np.hstack((tall, 0.1 * rng.standard_normal((2, 3)))))

    def squares(weight: np.ndarray) -> float:
        matrix = weight.reshape(2, 2)
        rest = np.eye(2) - matrix
        return sum(
            float(np.sum(part**2)) for part in (matrix @ own.generators, rest @ other.generators)
        )

    best = minimize(squares, np.full(4, 0.5), method="BFGS", options={"gtol": 1e-10})
    found = float(np.sum(intersection(own, other).generators ** 2))
    assert found == pytest.approx(best.fun, rel=1e-9)
    assert found < 0.1 * np.sum(own.generators**2)


def test_a_point_out_of_reach_has_no_gauge():
    flat = Zonotope(np.zeros(2), np.array([[1.0], [0.0]]))
    assert gauge(flat, np.array([0.5, 0.0])) == pytest.approx(0.5)
    assert gauge(flat, np.array([0.5, 0.1])) == np.inf
