"""Factors of small matrices in plain numbers are LAPACK's, and there is none where it has none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filters import compiled
from filters.gaussian import Gaussian
from filters.plain_cholesky import ROWS, plain_cholesky
from filters.sigma_points import scaled_unscented
from filters.ukf import predict
from tests.filters.support import random_spd

SIZES = range(1, ROWS + 1)


@given(st.sampled_from(SIZES), st.integers(0, 2**32 - 1))
def test_the_factor_is_that_of_numpy_and_takes_the_lower_triangle(n: int, seed: int):
    generator = np.random.default_rng(seed)
    matrix = random_spd(generator, (), n)
    given_ = np.tril(matrix) + np.triu(generator.standard_normal((n, n)), 1)
    factor = np.array(plain_cholesky(given_.tolist()))
    np.testing.assert_allclose(factor, np.linalg.cholesky(matrix), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(("n", "place"), [(n, place) for n in SIZES for place in range(n)])
@pytest.mark.parametrize("pivot", [-1.0, 0.0, np.nan])
def test_a_single_filter_whose_covariance_has_no_factor_is_nan(n, place, pivot, monkeypatch):
    monkeypatch.setattr(compiled, "KERNELS", None)
    cov = np.eye(n)
    cov[place, place] = pivot
    after = predict(
        Gaussian(np.ones(n), cov), lambda points: points, np.eye(n), scaled_unscented(n)
    )
    assert np.isnan(after.mean).all() and np.isnan(after.cov).all()
