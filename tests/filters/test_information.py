import numpy as np
import pytest

from filters import information, kalman
from filters.gaussian import Information, to_gaussian, to_information
from tests.filters.support import BATCHES, random_belief, random_spd


@pytest.mark.parametrize("lanes", BATCHES)
def test_it_is_the_kalman_filter(lanes):
    generator = np.random.default_rng(1)
    belief = random_belief(generator, lanes, 3)
    state = to_information(belief)
    F, H = generator.standard_normal((3, 3)), generator.standard_normal((2, 3))
    Q, R = random_spd(generator, lanes, 3), random_spd(generator, (), 2)
    for step in range(4):
        control, measurement = generator.standard_normal((2, *lanes, 3))
        measurement = measurement[..., :2]
        if step == 1:
            measurement[..., 0] = np.nan
        if step == 2:
            measurement[:] = np.nan
        belief = kalman.update(kalman.predict(belief, F, Q, control), measurement, H, R).belief
        state = information.predict(state, F, Q, control)
        state = information.update(state, measurement, H, R)
        returned = to_gaussian(state)
        np.testing.assert_allclose(returned.mean, belief.mean, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(returned.cov, belief.cov, rtol=1e-9, atol=1e-10)


def test_knowing_nothing_it_becomes_least_squares():
    """From no information at all, noiseless dynamics: the weighted least-squares fit of a line."""
    generator = np.random.default_rng(2)
    F, H, R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.array([[0.04]])
    measurements = 3.0 + 0.7 * np.arange(6) + 0.2 * generator.standard_normal(6)
    state = Information(np.zeros(2), np.zeros((2, 2)))
    for value in measurements:
        state = information.predict(state, F, np.zeros((2, 2)))
        state = information.update(state, np.array([value]), H, R)
    slope, end = np.polyfit(np.arange(6) - 5, measurements, 1)
    belief = to_gaussian(state)
    np.testing.assert_allclose(belief.mean, [end, slope], rtol=1e-10)
    design = np.stack([np.ones(6), np.arange(6) - 5], axis=-1)
    np.testing.assert_allclose(belief.cov, 0.04 * np.linalg.inv(design.T @ design), rtol=1e-10)


def test_a_singular_transition_is_refused():
    state = Information(np.zeros(2), np.eye(2))
    with pytest.raises(ValueError, match="transition matrix is singular"):
        information.predict(state, np.diag([1.0, 0.0]), np.eye(2))


def test_noise_that_is_not_definite_is_nan_in_its_lane():
    state = Information(np.zeros((2, 1)), np.ones((2, 1, 1)))
    noise = np.array([[[1.0]], [[-1.0]]])
    result = information.update(state, np.ones((2, 1)), np.eye(1), noise)
    np.testing.assert_allclose(result.vector[0], 1.0)
    assert np.isnan(result.vector[1]).all()
