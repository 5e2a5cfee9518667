"""The dual-layer filter: on linear models all of it can be written with matrices."""

import numpy as np
import pytest

from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.papers.adlukf import dual_layer
from tests.filters import kalman
from tests.filters.support import BATCHES, random_belief, random_spd

RULE = scaled_unscented(3, alpha=0.5, kappa=0.0)


def system(lanes: tuple[int, ...] = (), seed: int = 1):
    """A belief, a reading and F, H, Q, R of a linear system of 3 states and 2 readings."""
    generator = np.random.default_rng(seed)
    F, H = generator.standard_normal((3, 3)), generator.standard_normal((2, 3))
    Q, R = random_spd(generator, (), 3), random_spd(generator, (), 2)
    belief = random_belief(generator, lanes, 3)
    return belief, generator.standard_normal((*lanes, 2)), F, H, Q, R


def run(form, belief, z, F, H, Q, R):
    return form(belief, z, lambda x: x @ F.T, lambda x: x @ H.T, Q, R, RULE)


@pytest.mark.parametrize("lanes", BATCHES)
def test_the_literal_form_conditions_twice(lanes):
    belief, z, F, H, Q, R = system(lanes)
    step = run(dual_layer.literal, belief, z, F, H, Q, R)
    for lane in np.ndindex(lanes):
        P, m = belief.cov[lane], F @ belief.mean[lane]
        S = F @ P @ F.T + Q
        once = np.eye(3) - S @ H.T @ np.linalg.inv(H @ S @ H.T + R) @ H
        mean = m + (np.eye(3) - once) @ np.linalg.pinv(H) @ (z[lane] - H @ m)
        spread = once @ F @ P @ F.T @ once.T
        K = spread @ H.T @ np.linalg.inv(H @ spread @ H.T + R)
        cov = spread + Q - K @ (H @ spread @ H.T + R) @ K.T
        np.testing.assert_allclose(step.predicted[lane], mean, rtol=1e-8, atol=1e-8)
        after = mean + K @ (z[lane] - H @ mean)
        np.testing.assert_allclose(step.update.belief.mean[lane], after, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(step.update.belief.cov[lane], cov, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(step.measured_cov[lane], H @ spread @ H.T, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("lanes", BATCHES)
def test_the_consistent_form_is_the_kalman_filter(lanes):
    belief, z, F, H, Q, R = system(lanes)
    expected = kalman.update(kalman.predict(belief, F, Q), z, H, R).belief
    found = run(dual_layer.consistent, belief, z, F, H, Q, R).update.belief
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.cov, expected.cov, rtol=1e-8, atol=1e-8)


def test_the_literal_form_is_overconfident():
    """On a matched system e' P^-1 e should be 3 on average; the consistent form's is."""
    generator = np.random.default_rng(2)
    F = np.array([[0.9, 0.2, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.95]])
    H = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    Q, R, lanes, steps = 0.1 * np.eye(3), np.eye(2), 300, 40
    beliefs = dict.fromkeys(
        (dual_layer.literal, dual_layer.consistent),
        Gaussian(np.zeros((lanes, 3)), np.broadcast_to(np.eye(3), (lanes, 3, 3))),
    )
    truth, nees = generator.standard_normal((lanes, 3)), {}
    for _ in range(steps):
        truth = truth @ F.T + generator.standard_normal((lanes, 3)) @ np.sqrt(Q)
        z = truth @ H.T + generator.standard_normal((lanes, 2))
        for form, belief in beliefs.items():
            belief = run(form, belief, z, F, H, Q, R).update.belief
            error = (belief.mean - truth)[..., None]
            nees[form] = (error.mT @ np.linalg.inv(belief.cov) @ error).mean()
            beliefs[form] = belief
    # The mean over 300 independent lanes of a chi-square of 3 has a standard deviation of .14.
    assert abs(nees[dual_layer.consistent] - 3) < 0.6
    assert nees[dual_layer.literal] > 3.6


@pytest.mark.parametrize("form", [dual_layer.literal, dual_layer.consistent])
def test_a_reading_not_taken_leaves_the_prediction(form):
    belief, z, F, H, Q, R = system((4,))
    z[0] = np.nan
    z[1, 1] = np.nan
    found = run(form, belief, z, F, H, Q, R).update
    predicted = ukf.predict(belief, lambda x: x @ F.T, Q, RULE)
    np.testing.assert_allclose(found.belief.mean[0], predicted.mean[0], rtol=1e-9)
    np.testing.assert_allclose(found.belief.cov[0], predicted.cov[0], rtol=1e-9)
    alone = Gaussian(belief.mean[1], belief.cov[1])
    less = run(form, alone, z[1, :1], F, H[:1], Q, R[:1, :1]).update.belief
    np.testing.assert_allclose(found.belief.mean[1], less.mean, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(found.belief.cov[1], less.cov, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("form", [dual_layer.literal, dual_layer.consistent])
def test_a_lane_that_is_not_definite_fails_alone(form):
    belief, z, F, H, Q, R = system((3,))
    cov = belief.cov.copy()
    cov[1] = -np.eye(3)
    found = run(form, Gaussian(belief.mean, cov), z, F, H, Q, R).update.belief
    expected = run(form, belief, z, F, H, Q, R).update.belief
    assert np.isnan(found.mean[1]).all()
    np.testing.assert_allclose(found.mean[[0, 2]], expected.mean[[0, 2]], rtol=1e-12)
