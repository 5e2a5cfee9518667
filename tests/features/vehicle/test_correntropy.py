"""The maximum-correntropy update: its limit, its optimum, and what outliers do to it."""

from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize

from concord.features.vehicle.adaptive import correntropy
from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from tests.filters.support import (
    BATCHES,
    RANGE_BEARING_NOISE_COV,
    TURN_START,
    bearing_residual,
    random_belief,
    random_spd,
    range_bearing,
)

RULE = scaled_unscented(3)


def linear(seed: int = 1, lanes: tuple[int, ...] = ()):
    generator = np.random.default_rng(seed)
    H, R = generator.standard_normal((2, 3)), random_spd(generator, (), 2)
    return random_belief(generator, lanes, 3), generator.standard_normal((*lanes, 2)), H, R


def test_an_infinite_bandwidth_is_the_unscented_filter():
    z = range_bearing(TURN_START.mean) + np.array([5.0, 0.02])
    arguments = (TURN_START, z, range_bearing, RANGE_BEARING_NOISE_COV, scaled_unscented(5))
    ours = correntropy.update(*arguments, bandwidth=np.inf, residual=bearing_residual)
    theirs = ukf.update(*arguments, residual=bearing_residual)
    np.testing.assert_allclose(ours.belief.mean, theirs.belief.mean, rtol=1e-9)
    np.testing.assert_allclose(ours.belief.cov, theirs.belief.cov, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(ours.innovation_cov, theirs.innovation_cov, rtol=1e-12)


def test_it_maximises_the_correntropy():
    """The same optimum by a search that knows the objective only."""
    belief, z, H, R = linear()
    z = z + np.array([0.0, 4.0])
    state_root, noise_root = np.linalg.cholesky(belief.cov), np.linalg.cholesky(R)
    bandwidth = 2.0

    def loss(x):
        errors = np.concatenate(
            [np.linalg.solve(state_root, x - belief.mean), np.linalg.solve(noise_root, z - H @ x)]
        )
        return -np.exp(-(errors**2) / (2 * bandwidth**2)).sum()

    found = correntropy.update(
        belief, z, lambda x: x @ H.T, R, RULE, bandwidth, iterations=200
    ).belief.mean
    best = minimize(loss, found + 0.01, method="BFGS", options={"gtol": 1e-10})
    np.testing.assert_allclose(found, best.x, atol=1e-5)


def test_an_outlier_is_ignored_and_the_good_channel_is_not():
    belief = Gaussian(np.zeros(3), np.eye(3))
    H, R = np.eye(3)[:2], 0.01 * np.eye(2)
    update = partial(correntropy.update, belief, bandwidth=3.0, rule=RULE)
    found = update(np.array([1e6, 0.5]), measure=lambda x: x @ H.T, noise_cov=R).belief
    assert found.mean[0] == pytest.approx(0.0, abs=1e-9)
    assert found.cov[0, 0] == pytest.approx(1.0)
    without = update(np.array([np.nan, 0.5]), measure=lambda x: x @ H.T, noise_cov=R).belief
    np.testing.assert_allclose(found.mean, without.mean, atol=1e-9)
    assert found.mean[1] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("lanes", BATCHES)
def test_a_batch_is_its_lanes_one_by_one(lanes):
    belief, z, H, R = linear(3, lanes)
    if lanes:
        z[0] = np.nan
        z[-1, ..., 0] = np.nan
    found = correntropy.update(belief, z, lambda x: x @ H.T, R, RULE, 2.0).belief
    for lane in np.ndindex(lanes):
        alone = Gaussian(belief.mean[lane], belief.cov[lane])
        single = correntropy.update(alone, z[lane], lambda x: x @ H.T, R, RULE, 2.0).belief
        np.testing.assert_allclose(found.mean[lane], single.mean, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(found.cov[lane], single.cov, rtol=1e-10, atol=1e-12)


def test_a_bandwidth_that_is_none_is_refused():
    belief, z, H, R = linear()
    with pytest.raises(ValueError, match="choose 2 to 5"):
        correntropy.update(belief, z, lambda x: x @ H.T, R, RULE, 0.0)
