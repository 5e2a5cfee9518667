import numpy as np
import pytest

from filters.gaussian import Gaussian
from tests.filters import kalman
from tests.filters.support import BATCHES, random_belief, random_spd


def conditional(mean, cov, given, value):
    """Mean and covariance of a normal vector given some of its entries, by the block formula."""
    rest = [i for i in range(len(mean)) if i not in given]
    gain = cov[np.ix_(rest, given)] @ np.linalg.pinv(cov[np.ix_(given, given)])
    return (
        mean[rest] + gain @ (value - mean[given]),
        cov[np.ix_(rest, rest)] - gain @ cov[np.ix_(given, rest)],
    )


@pytest.mark.parametrize("lanes", BATCHES)
def test_it_is_conditioning_of_the_joint_distribution(lanes):
    generator = np.random.default_rng(1)
    belief = random_belief(generator, lanes, 3)
    F, H = generator.standard_normal((3, 3)), generator.standard_normal((2, 3))
    Q, R = random_spd(generator, lanes, 3), random_spd(generator, (), 2)
    control, measurement = generator.standard_normal((2, *lanes, 3))
    predicted = kalman.predict(belief, F, Q, control)
    update = kalman.update(predicted, measurement[..., :2], H, R)
    for lane in np.ndindex(lanes):
        mean = F @ belief.mean[lane] + control[lane]
        cov = F @ belief.cov[lane] @ F.T + Q[lane]
        np.testing.assert_allclose(predicted.mean[lane], mean, rtol=1e-12)
        np.testing.assert_allclose(predicted.cov[lane], cov, rtol=1e-12)
        joint_cov = np.block([[cov, cov @ H.T], [H @ cov, H @ cov @ H.T + R]])
        joint_mean = np.concatenate([mean, H @ mean])
        expected = conditional(joint_mean, joint_cov, [3, 4], measurement[lane][:2])
        np.testing.assert_allclose(update.belief.mean[lane], expected[0], rtol=1e-10)
        np.testing.assert_allclose(update.belief.cov[lane], expected[1], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(update.innovation_cov[lane], joint_cov[3:, 3:], rtol=1e-12)


def test_missing_rows_are_deleted_rows():
    generator = np.random.default_rng(2)
    belief = random_belief(generator, (4,), 3)
    H, R = generator.standard_normal((3, 3)), random_spd(generator, (), 3)
    measurement = generator.standard_normal((4, 3))
    measurement[0, 1] = measurement[1, [0, 2]] = measurement[2] = np.nan
    update = kalman.update(belief, measurement, H, R)
    for lane in (0, 1, 3):
        rows = np.flatnonzero(np.isfinite(measurement[lane]))
        prior = Gaussian(belief.mean[lane], belief.cov[lane])
        taken = measurement[lane, rows]
        expected = kalman.update(prior, taken, H[rows], R[np.ix_(rows, rows)])  # pyright: ignore[reportCallIssue]
        np.testing.assert_allclose(update.belief.mean[lane], expected.belief.mean, rtol=1e-12)
        np.testing.assert_allclose(update.belief.cov[lane], expected.belief.cov, rtol=1e-12)
        assert update.normalised_innovation_squared[lane] == pytest.approx(
            expected.normalised_innovation_squared
        )
    assert update.belief.mean[2].tobytes() == belief.mean[2].tobytes()
    assert update.belief.cov[2].tobytes() == belief.cov[2].tobytes()


def test_the_gate_keeps_outliers_out():
    belief = Gaussian(np.zeros((2, 1)), np.ones((2, 1, 1)))
    measurement = np.array([[1.9], [2.1]])  # innovation variance 1.25: 2.89 and 3.53
    update = kalman.update(belief, measurement, np.eye(1), np.array([[0.25]]), gate=3.0)
    np.testing.assert_allclose(update.belief.mean[:, 0], [1.9 / 1.25, 0.0])


def test_josephs_form_stays_definite_where_the_short_form_does_not():
    belief = Gaussian(np.zeros(2), np.diag([1e8, 1e8]))
    H, R = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-6]]), 1e-6 * np.eye(2)
    cov = kalman.update(belief, np.zeros(2), H, R).belief.cov
    assert (np.linalg.eigvalsh(cov) > 0).all()
    K = belief.cov @ H.T @ np.linalg.inv(H @ belief.cov @ H.T + R)
    short = belief.cov - K @ H @ belief.cov
    assert not (np.linalg.eigvalsh(0.5 * (short + short.T)) > 0).all()


def test_a_failed_lane_is_nan_alone():
    belief = random_belief(np.random.default_rng(3), (3,), 2)
    belief.cov[1] = -100 * np.eye(2)
    update = kalman.update(belief, np.zeros((3, 2)), np.eye(2), np.eye(2))
    assert np.isnan(update.belief.mean[1]).all()
    assert np.isfinite(update.belief.mean[[0, 2]]).all()


def test_noise_that_does_not_fit_is_named():
    belief = Gaussian(np.zeros(2), np.eye(2))
    with pytest.raises(ValueError, match="process noise covariance has shape"):
        kalman.predict(belief, np.eye(2), np.eye(1))
    with pytest.raises(ValueError, match="measurement noise covariance has shape"):
        kalman.update(belief, np.zeros(2), np.eye(2), np.eye(1))
