"""The bootstrap filter: systematic resampling by its counts, and the Kalman filter as its limit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from concord.filters.gaussian import Gaussian
from concord.filters.particle import Particles, cov, mean, resample, weights
from tests.filters import kalman


@given(st.integers(0, 2**20), st.integers(1, 40))
def test_everyone_is_drawn_as_often_as_its_weight_says(seed: int, count: int):
    generator = np.random.default_rng(seed)
    logs = generator.normal(scale=3.0, size=(2, 3, count))
    states = np.broadcast_to(np.arange(count, dtype=float)[:, None], (2, 3, count, 1))
    cloud = Particles(states, logs)
    drawn = resample(cloud, generator.random((2, 3)))
    expected = count * weights(cloud)
    for lane in np.ndindex(2, 3):
        copies = np.bincount(drawn.states[lane][:, 0].astype(int), minlength=count)
        assert copies.sum() == count
        assert (np.abs(copies - expected[lane]) < 1 + 1e-9).all()


def test_weights_survive_tiny_likelihoods():
    logs = np.array([-1e5, -1e5 + np.log(3.0)])
    np.testing.assert_allclose(weights(Particles(np.zeros((2, 1)), logs)), [0.25, 0.75])


def test_on_a_linear_system_it_is_the_kalman_filter_but_for_chance():
    generator = np.random.default_rng(8)
    transition, row = np.array([[0.9, 0.3], [-0.2, 0.8]]), np.array([[1.0, 0.5]])
    process_cov, variance, lanes, count = 0.1 * np.eye(2), 0.2, 40, 3000
    belief = Gaussian(np.zeros((lanes, 2)), np.broadcast_to(np.eye(2), (lanes, 2, 2)))
    truth = generator.standard_normal((lanes, 2))
    cloud = Particles(generator.standard_normal((lanes, count, 2)), np.zeros((lanes, count)))
    for _ in range(8):
        truth = truth @ transition.T + np.sqrt(0.1) * generator.standard_normal((lanes, 2))
        seen = truth @ row.T + np.sqrt(variance) * generator.standard_normal((lanes, 1))
        cloud = resample(cloud, generator.random(lanes))
        noise = np.sqrt(0.1) * generator.standard_normal((lanes, count, 2))
        states = cloud.states @ transition.T + noise
        logs = -0.5 * (seen - (states @ row.T)[..., 0]) ** 2 / variance
        cloud = Particles(states, cloud.log_weights + logs)
        belief = kalman.predict(belief, transition, process_cov)
        belief = kalman.update(belief, seen, row, variance * np.eye(1)).belief
    deviation = (mean(cloud) - belief.mean) / np.sqrt(np.diagonal(belief.cov, axis1=1, axis2=2))
    # A weighted mean of some hundreds of effective particles, over 40 lanes and 8 steps.
    assert np.abs(deviation).max() < 0.3
    assert np.abs(deviation.mean(axis=0)).max() < 0.03
    np.testing.assert_allclose(cov(cloud).mean(axis=0), belief.cov[0], rtol=0.08)
