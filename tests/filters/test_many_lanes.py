"""Batches of many lanes, which go along the lanes, equal small batches, which go to LAPACK."""

import numpy as np
import pytest

from concord.filters import ukf
from concord.filters.columns import MANY_LANES
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, factor_and_inverse, inverse_of_triangle, solve_spd
from tests.filters.support import bearing_residual, random_belief, random_spd, rules

LANES = 2 * MANY_LANES
agree = np.testing.assert_allclose


def bend(points: np.ndarray) -> np.ndarray:
    return points + 0.1 * np.sin(points) + 0.05 * np.roll(points, 1, axis=-1) ** 2


def sense(points: np.ndarray) -> np.ndarray:
    return np.stack([np.hypot(points[..., 0], points[..., 1]), points[..., 2]], axis=-1)


@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_matrices_of_many_lanes_are_those_of_numpy(n):
    matrices = random_spd(np.random.default_rng(n), (2, MANY_LANES), n)
    right = np.random.default_rng(1).standard_normal((2, MANY_LANES, n, 2))
    factor, inverse = factor_and_inverse(matrices)
    for lane in np.ndindex(2, MANY_LANES):
        one = matrices[lane]
        agree(factor[lane], np.linalg.cholesky(one), rtol=1e-10, atol=1e-12)
        agree(inverse[lane], np.linalg.inv(one), rtol=1e-9, atol=1e-11)
    agree(solve_spd(matrices, right), np.linalg.solve(matrices, right), rtol=1e-9, atol=1e-10)
    agree(inverse_of_triangle(factor) @ factor - np.eye(n), np.zeros_like(factor), atol=1e-11)


@pytest.mark.parametrize("failing", [0, 2])
def test_lanes_that_fail_are_nan_alone(failing):
    """Not definite from the first pivot on, or at the last alone."""
    matrices = random_spd(np.random.default_rng(5), (LANES,), 3)
    matrices[1, failing, failing], matrices[3] = -1.0, np.nan
    matrices[7, failing] = matrices[7, :, failing] = 0.0
    matrices[9, failing, failing] = 0.0
    factor = cholesky(matrices)
    lost = np.isnan(factor).any(axis=(1, 2))
    assert np.flatnonzero(lost).tolist() == [1, 3, 7, 9]
    assert np.isnan(factor[lost]).all()
    agree(factor[~lost], np.linalg.cholesky(matrices[~lost]), rtol=1e-10, atol=1e-12)


def test_a_whole_step_is_the_same_in_many_lanes_and_in_few():
    generator, rule = np.random.default_rng(7), rules(4)["unscented"]
    belief = random_belief(generator, (LANES,), 4)
    readings = generator.standard_normal((LANES, 2))
    readings[3], readings[5, 1] = np.nan, np.nan

    def step(part: slice):
        prior = Gaussian(belief.mean[part], belief.cov[part])
        predicted = ukf.predict(prior, bend, np.eye(4), rule)
        result = ukf.update(
            predicted, readings[part], sense, np.eye(2), rule, residual=bearing_residual
        )
        return *result.belief, *result[1:]

    together = step(slice(None))
    for begin in range(0, LANES, 10):
        part = slice(begin, begin + 10)
        for ours, theirs in zip(step(part), together, strict=True):
            agree(ours, theirs[part], rtol=1e-11, atol=1e-12)


def test_results_of_many_lanes_keep_lanes_contiguous():
    """So that a chain of steps never turns its memory over."""
    belief = random_belief(np.random.default_rng(1), (2, MANY_LANES), 3)
    seen = []

    def remember(points: np.ndarray) -> np.ndarray:
        seen.append(points[..., 0].flags.c_contiguous)
        return np.copy(points, order="K")

    rule = rules(3)["unscented"]
    predicted = ukf.predict(belief, remember, np.eye(3), rule)
    readings = np.zeros((2, MANY_LANES, 3))
    updated = ukf.update(predicted, readings, remember, np.eye(3), rule).belief
    assert seen == [True, True]
    for mean, cov in (predicted, updated):
        assert mean.transpose(2, 0, 1).flags.c_contiguous
        assert cov.transpose(2, 3, 0, 1).flags.c_contiguous


@pytest.mark.parametrize("lanes", [(), (LANES,)])
def test_covariances_are_symmetric_to_the_last_bit(lanes):
    """Also where the centre weighs less than nothing."""
    rule, belief = rules(5)["narrow"], random_belief(np.random.default_rng(9), lanes, 5)
    assert rule.cov_weights[0] < 0
    predicted = ukf.predict(belief, bend, np.eye(5), rule)
    updated = ukf.update(predicted, np.zeros((*lanes, 2)), sense, np.eye(2), rule).belief
    for cov in (predicted.cov, updated.cov):
        np.testing.assert_array_equal(cov, cov.mT)
