"""Sets on the wire: what is decoded holds what was encoded, in every number format."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.features.sets.filters.ellipsoid import Ellipsoid, squared_radius
from concord.features.sets.filters.zonotope import Zonotope, gauge
from concord.features.sets.set_shapes import Ellipsoids, Zonotopes, relative_size
from concord.filters.gaussian import Gaussian

SEEDS = st.integers(0, 2**32 - 1)


def travelled(shape, own):
    """Return a set as a receiver decodes it from the number format of the shape."""
    came, sound = shape.read(shape.numbers_of(own).astype(shape.number).astype(float))
    assert sound
    return came


NUMBERS = pytest.mark.parametrize("number", ["<f8", "<f4"])


@NUMBERS
@settings(max_examples=40)
@given(seed=SEEDS, n=st.integers(1, 5), scale=st.integers(-4, 6))
def test_an_ellipsoid_that_travelled_holds_what_it_held(number: str, seed: int, n: int, scale: int):
    rng = np.random.default_rng(seed)
    factor = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(-3, 1, (1, n))
    own = Ellipsoid(10.0**scale * rng.standard_normal(n), factor)
    codec = Ellipsoids(n, number)
    came = travelled(codec, own)
    u = rng.standard_normal((20, n))
    points = own.centre + (u / np.linalg.norm(u, axis=-1, keepdims=True)) @ factor.T
    lanes = Ellipsoid(
        np.broadcast_to(came.centre, (20, n)), np.broadcast_to(came.factor, (20, n, n))
    )
    # The points themselves are rounded where the centre is large.
    slack = 20 * 2.0**-52 * np.abs(points).max() / np.linalg.svd(came.factor)[1].min()
    assert (squared_radius(lanes, points) <= (1 + slack) ** 2).all()


@NUMBERS
@settings(max_examples=25)
@given(seed=SEEDS, n=st.integers(1, 4))
def test_a_zonotope_that_travelled_holds_what_it_held(number: str, seed: int, n: int):
    rng = np.random.default_rng(seed)
    own = Zonotope(rng.standard_normal(n), rng.standard_normal((n, 3 * n)))
    codec = Zonotopes(n, number)
    corner = own.centre + own.generators @ rng.choice([-1.0, 1.0], 3 * n)
    assert gauge(travelled(codec, own), corner) <= 1 + 1e-7


def test_the_estimate_is_an_ellipsoid_around_the_set():
    rng = np.random.default_rng(0)
    zonotope = Zonotope(rng.standard_normal(3), rng.standard_normal((3, 9)))
    bounds = Zonotopes(3).bounds(zonotope)
    corner = zonotope.centre + zonotope.generators @ rng.choice([-1.0, 1.0], 9)
    error = corner - bounds.mean
    assert error @ np.linalg.solve(bounds.cov, error) <= 1
    ellipsoid = Ellipsoid(np.zeros(2), np.array([[1.0, 0.0], [0.5, 2.0]]))
    shape = Ellipsoids(2).bounds(ellipsoid).cov
    expected = ellipsoid.factor @ ellipsoid.factor.T
    np.testing.assert_allclose(shape, expected, rtol=1e-12)
    assert (np.linalg.eigvalsh(shape - expected) >= 0).all()


@pytest.mark.parametrize("numbers", [[0.0, 0.0, 1.0, 2.0, 1.0], [0.0, 0.0, -1.0, 0.0, 1.0]])
def test_numbers_that_are_no_ellipsoid_are_refused(numbers: list[float]):
    ball = [0.0, 0.0, 1.0, 0.0, 1.0]
    assert Ellipsoids(2).read(np.array([numbers, ball]))[1].tolist() == [False, True]


@pytest.mark.parametrize("shape", [Ellipsoids(2), Zonotopes(2)])
def test_sets_with_nothing_in_common_are_told_apart(shape):
    ball = shape.containing(Gaussian(np.zeros(2), np.eye(2)))
    far = shape.containing(Gaussian(np.array([5.0, 0.0]), np.eye(2)))
    near = shape.containing(Gaussian(np.array([0.5, 0.0]), np.eye(2)))
    assert not shape.meet(ball, far)[1]

    def size(own) -> float:
        return float(relative_size(shape.half_widths(own), shape.half_widths(ball)))

    assert size(shape.meet(ball, near)[0]) <= 1 + 1e-12
    row = np.array([1.0, 0.0])
    assert not shape.cut(ball, row, np.array(3.0), np.array(0.5))[1]
    assert size(shape.cut(ball, row, np.array(0.5), np.array(0.1))[0]) < 1
