"""Error, consistency and disagreement against loops and scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from concord.filters.metrics import consensus, mean_of_known, nees, rmse
from tests.filters.support import random_spd

SEEDS = st.integers(0, 2**32 - 1)
BATCHES = st.sampled_from([(), (1,), (5,), (3, 4), (3, 1, 2)])


@given(SEEDS, BATCHES, st.integers(1, 4))
def test_nees_is_the_exponent_of_the_density(seed: int, lanes: tuple[int, ...], m: int):
    """log p(e) = log p(0) - NEES / 2, by scipy."""
    generator = np.random.default_rng(seed)
    errors = generator.standard_normal((*lanes, m))
    cov = random_spd(generator, lanes, m)
    found = nees(errors, cov)
    assert found.shape == lanes
    for lane in np.ndindex(lanes):
        at_zero, at_error = (
            multivariate_normal.logpdf(x, np.zeros(m), cov[lane])  # type: ignore[arg-type]
            for x in (np.zeros(m), errors[lane])
        )
        expected = 2 * float(at_zero - at_error)
        assert found[lane] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(SEEDS, st.integers(1, 3), st.floats(0, 0.6))
def test_rmse_is_the_loop_over_what_is_known(seed: int, m: int, unknown: float):
    generator = np.random.default_rng(seed)
    errors = generator.standard_normal((6, 3, m))
    errors[generator.random((6, 3)) < unknown, 0] = np.nan
    expected = []
    for node in range(3):
        squares = [
            sum(x * x for x in errors[step, node].tolist())
            for step in range(6)
            if not np.isnan(errors[step, node]).any()
        ]
        expected.append(np.sqrt(sum(squares) / len(squares)) if squares else np.nan)
    np.testing.assert_allclose(rmse(errors, (0,)), expected, rtol=1e-12)


@given(SEEDS, st.floats(0, 0.6))
def test_the_mean_of_nees_is_that_over_what_is_known(seed: int, unknown: float):
    generator = np.random.default_rng(seed)
    errors, cov = generator.standard_normal((7, 2, 3)), random_spd(generator, (7, 2), 3)
    errors[generator.random((7, 2)) < unknown] = np.nan
    values = [
        float(errors[k, i] @ np.linalg.inv(cov[k, i]) @ errors[k, i])
        for k in range(7)
        for i in range(2)
        if not np.isnan(errors[k, i, 0])
    ]
    expected = sum(values) / len(values) if values else np.nan
    np.testing.assert_allclose(mean_of_known(nees(errors, cov), (0, 1)), expected, rtol=1e-9)


def test_nothing_known_says_nothing():
    nothing = np.full((4, 2, 2), np.nan)
    assert np.isnan(rmse(nothing, (0,))).all()
    assert np.isnan(nees(nothing, np.broadcast_to(np.eye(2), (4, 2, 2, 2)))).all()


@given(SEEDS, st.integers(1, 6))
def test_disagreement_is_the_mean_distance_of_pairs(seed: int, nodes: int):
    """The mean square distance from the average is half that of all ordered pairs."""
    mean = np.random.default_rng(seed).standard_normal((4, nodes, 2))
    squares = [
        ((mean[k, i] - mean[k, j]) ** 2).sum()
        for k in range(4)
        for i in range(nodes)
        for j in range(nodes)
    ]
    assert rmse(mean - consensus(mean), (0, 1)) == pytest.approx(
        np.sqrt(np.mean(squares) / 2), rel=1e-9, abs=1e-12
    )
