import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filters import square_root, ukf
from filters.gaussian import Gaussian, SquareRootGaussian, from_square_root, to_square_root
from filters.sigma_points import cubature, scaled_unscented
from tests.filters.support import (
    BATCHES,
    RANGE_BEARING_NOISE_COV,
    RULE_NAMES,
    TURN_NOISE_COV,
    TURN_START,
    bearing_residual,
    random_spd,
    range_bearing,
    rules,
    turn,
    turn_track,
    wrap,
)

PROCESS_FACTOR = np.linalg.cholesky(TURN_NOISE_COV)
# Correlated, so that a row that goes missing takes its correlation along.
MEASUREMENT_NOISE_COV = RANGE_BEARING_NOISE_COV + 0.1 * (np.ones((2, 2)) - np.eye(2))
MEASUREMENT_FACTOR = np.linalg.cholesky(MEASUREMENT_NOISE_COV)


def spread_start(lanes: tuple[int, ...]) -> Gaussian:
    scale = np.random.default_rng(1).uniform(0.2, 1.0, (*lanes, 1, 1))
    return Gaussian(np.broadcast_to(TURN_START.mean, (*lanes, 5)), scale * TURN_START.cov)


@pytest.mark.parametrize("name", RULE_NAMES)
@pytest.mark.parametrize("lanes", BATCHES)
def test_it_is_the_covariance_form(name, lanes):
    rule, covariance_form = rules(5)[name], spread_start(lanes)
    belief = to_square_root(covariance_form)
    track = turn_track(np.random.default_rng(2), 8)
    track[3, 0] = track[5] = np.nan
    for measurement in track:
        measurement = np.broadcast_to(measurement, (*lanes, 2))
        covariance_form = ukf.predict(covariance_form, turn, TURN_NOISE_COV, rule)
        expected = ukf.update(
            covariance_form,
            measurement,
            range_bearing,
            MEASUREMENT_NOISE_COV,
            rule,
            residual=bearing_residual,
            gate=6.0,
        )
        belief = square_root.predict(belief, turn, PROCESS_FACTOR, rule)
        update = square_root.update(
            belief,
            measurement,
            range_bearing,
            MEASUREMENT_FACTOR,
            rule,
            residual=bearing_residual,
            gate=6.0,
        )
        covariance_form, belief = expected.belief, update.belief
        returned = from_square_root(belief)
        np.testing.assert_allclose(returned.mean, covariance_form.mean, rtol=1e-10)
        scale = np.abs(covariance_form.cov).max()
        np.testing.assert_allclose(
            returned.cov, covariance_form.cov, rtol=1e-10, atol=1e-10 * scale
        )
        for ours, theirs in zip(update[1:], expected[1:], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("deviation", [0.3, 2.1])
def test_it_is_the_covariance_form_for_a_state_angle_at_the_wrap(deviation):
    def difference(a, b):
        return wrap(a - b)

    def advance(points):
        return wrap(points + 0.2)

    rule, noise, seen = scaled_unscented(1), np.array([[0.2]]), np.array([-3.0])
    expected = Gaussian(np.array([3.0]), np.array([[deviation**2]]))
    belief = to_square_root(expected)
    update = square_root.update(
        belief, seen, wrap, noise, rule, residual=difference, state_residual=difference
    )
    reference = ukf.update(
        expected, seen, wrap, noise**2, rule, residual=difference, state_residual=difference
    )
    np.testing.assert_allclose(update.belief.mean, reference.belief.mean, rtol=1e-12)
    belief = square_root.predict(belief, advance, noise, rule, difference)
    expected = ukf.predict(expected, advance, noise**2, rule, difference)
    np.testing.assert_allclose(belief.mean, expected.mean, rtol=1e-12)
    np.testing.assert_allclose(belief.factor**2, expected.cov, rtol=1e-12)


@settings(deadline=None)
@given(n=st.integers(1, 6), lanes=st.sampled_from(BATCHES), seed=st.integers(0, 2**16))
def test_downdate_takes_away_what_was_added(n, lanes, seed):
    generator = np.random.default_rng(seed)
    cov, vector = random_spd(generator, lanes, n), generator.standard_normal((*lanes, n))
    outer = vector[..., :, None] * vector[..., None, :]
    factor = square_root.downdate(np.linalg.cholesky(cov + outer), vector)
    assert np.array_equal(factor, np.tril(factor))
    np.testing.assert_allclose(factor @ factor.mT, cov, rtol=1e-9, atol=1e-9)


def test_downdate_beyond_definiteness_is_nan_in_its_lane():
    factor = np.broadcast_to(np.eye(3), (3, 3, 3))
    vector = np.array([[0.5, 0.0, 0.0], [0.8, 0.6, 0.1], [0.0, 0.0, 0.9]])
    result = square_root.downdate(factor, vector)
    assert np.isnan(result[1]).all()
    assert np.isfinite(result[[0, 2]]).all()


@settings(deadline=None)
@given(n=st.integers(1, 6), extra=st.integers(0, 5), lanes=st.sampled_from(BATCHES))
def test_triangularisation_keeps_the_square(n, extra, lanes):
    rows = np.random.default_rng(n).standard_normal((*lanes, n + extra, n))
    factor = square_root.triangularise(rows)
    assert np.array_equal(factor, np.tril(factor))
    assert (np.diagonal(factor, axis1=-2, axis2=-1) >= 0).all()
    np.testing.assert_allclose(factor @ factor.mT, rows.mT @ rows, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("name", ["unscented", "narrow"])
def test_a_failed_lane_is_nan_alone(name):
    rule, belief = rules(5)[name], to_square_root(spread_start((3,)))
    belief.factor[1] = np.nan
    belief = square_root.predict(belief, turn, PROCESS_FACTOR, rule)
    measurement = range_bearing(TURN_START.mean)
    belief = square_root.update(belief, measurement, range_bearing, MEASUREMENT_FACTOR, rule).belief
    assert np.isnan(belief.mean[1]).all()
    assert np.isnan(belief.factor[1]).all()
    assert np.isfinite(belief.mean[[0, 2]]).all()
    assert np.isfinite(belief.factor[[0, 2]]).all()


def test_a_singular_innovation_is_nan_in_its_lane():
    belief = SquareRootGaussian(np.zeros((2, 1)), np.array([[[0.0]], [[1.0]]]))
    update = square_root.update(
        belief, np.ones((2, 1)), lambda x: x, np.array([[0.0]]), cubature(1)
    )
    assert np.isnan(update.belief.mean[0]).all()
    np.testing.assert_allclose(update.belief.mean[1], 1.0)  # a perfect measurement


def test_it_carries_a_state_known_exactly():
    """A zero column is no failure here, as it is for the covariance form."""
    belief = SquareRootGaussian(np.array([1.0, 2.0]), np.diag([0.5, 0.0]))
    belief = square_root.predict(belief, lambda x: x, np.zeros((2, 2)), cubature(2))
    np.testing.assert_allclose(belief.factor, np.diag([0.5, 0.0]), atol=1e-15)


def test_it_resolves_a_condition_number_that_the_covariance_cannot():
    """After a measurement of 1e-9 against a prior of 1, P rounds; its root does not."""
    rule, sharp = scaled_unscented(2), 1e-9
    belief = SquareRootGaussian(np.zeros(2), np.eye(2))
    for _ in range(3):
        belief = square_root.update(
            belief, np.zeros(1), lambda x: x[..., :1] + x[..., 1:], np.array([[sharp]]), rule
        ).belief
    # By hand: along (1, 1) the deviation is sharp / sqrt(2 * 3), across it stays 1.
    along = np.linalg.norm(belief.factor.T @ np.array([1.0, 1.0])) / np.sqrt(2)
    across = np.linalg.norm(belief.factor.T @ np.array([1.0, -1.0])) / np.sqrt(2)
    assert along == pytest.approx(sharp / np.sqrt(6), rel=1e-5)
    assert across == pytest.approx(1.0)
