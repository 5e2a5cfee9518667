"""Updates with readings far sharper than the prior, against exact rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest

from concord.filters import square_root, ukf
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import cubature, scaled_unscented
from concord.filters.square_root import SquareRootFilter
from tests.filters.support import random_belief, random_spd, turn

Matrix = list[list[Fraction]]


def exact(matrix: np.ndarray) -> Matrix:
    return [[Fraction(float(value)) for value in row] for row in matrix]


def product(left: Matrix, right: Matrix) -> Matrix:
    return [
        [sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0))
         for column in zip(*right, strict=True)]
        for row in left
    ]  # fmt: skip


def inverse_of_two(matrix: Matrix) -> Matrix:
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    return [[d / determinant, -b / determinant], [-c / determinant, a / determinant]]


def posterior_cov(P: np.ndarray, R: np.ndarray) -> np.ndarray:
    """P - P H' (H P H' + R)^-1 H P without rounding, for readings of the first two states."""
    prior = exact(P)
    S = [[prior[i][j] + Fraction(float(R[i, j])) for j in range(2)] for i in range(2)]
    gain = product([row[:2] for row in prior], inverse_of_two(S))
    away = product(gain, prior[:2])
    return np.array([[float(p - a) for p, a in zip(*rows, strict=True)]
                     for rows in zip(prior, away, strict=True)])  # fmt: skip


def two(x: np.ndarray) -> np.ndarray:
    return x[..., :2]


@pytest.mark.parametrize("exponent", [9, 11, 13, 14, 15, 16])
def test_a_sharp_reading_leaves_the_covariance_that_exact_arithmetic_gives(exponent: int):
    generator = np.random.default_rng(exponent)
    for _ in range(20):
        P = 10.0**exponent * random_spd(generator, (), 3)
        R = random_spd(generator, (), 2)
        found = ukf.update(Gaussian(np.zeros(3), P), np.ones(2), two, R, scaled_unscented(3))
        expected = posterior_cov(P, R)[:2, :2]
        root = np.linalg.cholesky(expected)
        whitened = np.linalg.solve(root, np.linalg.solve(root, found.belief.cov[:2, :2]).T)
        # The subtraction of covariances errs by 10^(exponent - 15).
        np.testing.assert_allclose(whitened, np.eye(2), atol=1e-5 if exponent < 10 else 1e-9)


def test_a_covariance_that_cannot_hold_the_result_is_lost_and_never_indefinite():
    generator = np.random.default_rng(1)
    P = 1e18 * random_spd(generator, (200,), 3)
    H = generator.standard_normal((2, 3))
    for rule in (scaled_unscented(3), cubature(3), scaled_unscented(3, alpha=0.5)):
        belief = Gaussian(np.zeros((200, 3)), P)
        after = ukf.update(belief, np.ones((200, 2)), lambda x: x @ H.T, np.eye(2), rule).belief
        is_lost = np.isnan(after.cov).all(axis=(-1, -2))
        assert is_lost.any() and np.isfinite(cholesky(after.cov[~is_lost])).all()


def test_both_forms_are_one_where_nothing_is_lost():
    generator = np.random.default_rng(2)
    belief, R = random_belief(generator, (4, 3), 5), random_spd(generator, (), 2)
    z = generator.standard_normal((4, 3, 2))
    z[0, 0], z[1, 1, 1] = np.nan, np.nan
    for rule in (scaled_unscented(5), cubature(5)):
        found = square_root.update(belief, z, two, R, rule, gate=3.0)
        expected = ukf.update(belief, z, two, R, rule, gate=3.0)
        for one, other in zip(
            (*found.belief, *found[1:]), (*expected.belief, *expected[1:]), strict=True
        ):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10)


def test_only_the_lanes_with_sharp_readings_change_their_form():
    generator = np.random.default_rng(3)
    belief, R = random_belief(generator, (3,), 3), np.eye(2)
    belief.cov[1] *= 1e14
    z = generator.standard_normal((3, 2))
    together = ukf.update(belief, z, two, R, scaled_unscented(3))
    for lane in range(3):
        own = Gaussian(belief.mean[lane], belief.cov[lane])
        alone = ukf.update(own, z[lane], two, R, scaled_unscented(3)).belief
        np.testing.assert_allclose(together.belief.cov[lane], alone.cov, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(together.belief.mean[lane], alone.mean, rtol=1e-9, atol=1e-12)


def test_an_entry_that_was_not_taken_asks_for_no_other_form():
    cov, noise_cov = np.eye(2) * np.array([[[1.0]], [[1.0]]]), np.zeros((2, 2, 2))
    missing = np.full((2, 2), np.nan)
    assert square_root.cancels(cov, noise_cov, missing) is None
    taken = np.array([[np.nan, np.nan], [np.nan, 0.5]])
    np.testing.assert_array_equal(square_root.cancels(cov, noise_cov, taken), [False, True])


@pytest.mark.parametrize("lanes", [(), (4, 3)])
def test_a_prediction_by_factors_is_that_of_covariances(lanes: tuple[int, ...]):
    generator = np.random.default_rng(4)
    belief, Q = random_belief(generator, lanes, 5), random_spd(generator, (), 5)
    for rule in (scaled_unscented(5), cubature(5)):
        for noise_cov in (Q, np.diag([1.0, 0.0, 2.0, 0.0, 0.0]), np.zeros((5, 5))):
            found = SquareRootFilter(rule).predict(belief, turn, noise_cov)
            expected = ukf.predict(belief, turn, noise_cov, rule)
            np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(found.cov, expected.cov, rtol=1e-9, atol=1e-9)


def test_an_update_by_factors_keeps_digits_that_a_difference_loses():
    """At a ratio of 1e9 the other form is still used by the `ukf`, and errs by 3e-6."""
    generator = np.random.default_rng(5)
    worst = {"factors": 0.0, "difference": 0.0}
    for _ in range(20):
        P, R = 1e9 * random_spd(generator, (), 3), random_spd(generator, (), 2)
        root = np.linalg.cholesky(posterior_cov(P, R)[:2, :2])
        belief = Gaussian(np.zeros(3), P)
        for name, filter in (
            ("factors", SquareRootFilter(scaled_unscented(3))),
            ("difference", SigmaPointFilter(scaled_unscented(3))),
        ):
            cov = filter.update(belief, np.ones(2), two, R).belief.cov[:2, :2]
            whitened = np.linalg.solve(root, np.linalg.solve(root, cov).T)
            worst[name] = max(worst[name], np.abs(whitened - np.eye(2)).max())
    assert worst["factors"] < 1e-10 and worst["difference"] > 1e-8


def test_a_lane_without_a_number_fails_alone():
    generator = np.random.default_rng(6)
    belief, Q = random_belief(generator, (3,), 5), np.repeat(np.eye(5)[None], 3, axis=0)
    Q[1, 0, 0] = np.nan
    found = SquareRootFilter(cubature(5)).predict(belief, turn, Q)
    assert np.isnan(found.cov[1]).all() and np.isfinite(found.cov[[0, 2]]).all()


def test_sigma_points_with_a_negative_weight_are_refused():
    with pytest.raises(ValueError, match=r"negative weight.*--filter srckf"):
        SquareRootFilter(scaled_unscented(12))
