import numpy as np
import pytest

from filters import extended, kalman, ukf
from filters.gaussian import Gaussian
from filters.sigma_points import scaled_unscented
from tests.filters.support import (
    BATCHES,
    RANGE_BEARING_NOISE_COV,
    TURN_NOISE_COV,
    TURN_START,
    bearing_residual,
    random_belief,
    random_spd,
    range_bearing,
    range_bearing_jacobian,
    turn,
)


def turn_jacobian(state: np.ndarray) -> np.ndarray:
    """Derivative of `turn` at one state by complex steps, exact to rounding."""
    steps = state + 1e-30j * np.eye(5)
    return np.imag(turn(steps)).T / 1e-30


@pytest.mark.parametrize("lanes", BATCHES)
def test_it_is_the_kalman_filter_on_linear_models(lanes):
    generator = np.random.default_rng(1)
    belief = random_belief(generator, lanes, 3)
    F, H = generator.standard_normal((3, 3)), generator.standard_normal((2, 3))
    Q, R = random_spd(generator, (), 3), random_spd(generator, (), 2)
    measurement = generator.standard_normal((*lanes, 2))
    ours = extended.predict(belief, lambda x: x @ F.T, lambda x: F, Q)
    theirs = kalman.predict(belief, F, Q)
    np.testing.assert_allclose(ours.mean, theirs.mean, rtol=1e-12, atol=1e-12)
    update = extended.update(ours, measurement, lambda x: x @ H.T, lambda x: H, R)
    expected = kalman.update(theirs, measurement, H, R)
    np.testing.assert_allclose(update.belief.mean, expected.belief.mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(update.belief.cov, expected.belief.cov, rtol=1e-12, atol=1e-12)


def test_it_meets_the_unscented_filter_at_second_order_in_the_spread():
    rule = scaled_unscented(5)
    differences = []
    for scale in (1e-1, 1e-2, 1e-3):
        belief = Gaussian(TURN_START.mean, scale**2 * TURN_START.cov)
        noise = scale**2 * TURN_NOISE_COV
        ours = extended.predict(belief, turn, turn_jacobian, noise)
        theirs = ukf.predict(belief, turn, noise, rule)
        noise = scale**2 * RANGE_BEARING_NOISE_COV
        seen = range_bearing(ours.mean) + scale * np.array([10.0, 0.03])
        ours = extended.update(ours, seen, range_bearing, range_bearing_jacobian, noise).belief
        theirs = ukf.update(theirs, seen, range_bearing, noise, rule).belief
        differences.append(np.abs(ours.mean - theirs.mean).max())
    orders = np.log10(np.array(differences[:-1]) / differences[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


@pytest.mark.parametrize("lanes", BATCHES)
def test_bearings_wrap_rows_go_missing_and_outliers_stay_out(lanes):
    mean = np.broadcast_to(
        np.array([-300.0, 0, 80.5, 0, 0.1]), (*lanes, 5)
    )  # due west of the sensor
    belief = Gaussian(mean, np.broadcast_to(TURN_START.cov, (*lanes, 5, 5)))
    seen = np.broadcast_to([np.nan, -np.pi + 0.01], (*lanes, 2))

    def update(measurement, gate=None):
        return extended.update(
            belief,
            measurement,
            range_bearing,
            range_bearing_jacobian,
            RANGE_BEARING_NOISE_COV,
            residual=bearing_residual,
            gate=gate,
        )

    taken = update(seen)
    assert np.abs(taken.innovation[..., 1]).max() < 0.02
    assert np.isnan(taken.innovation[..., 0]).all()
    outlier = update(np.broadcast_to([1e5, 0.0], (*lanes, 2)), gate=20.0)
    np.testing.assert_array_equal(outlier.belief.mean, belief.mean)
