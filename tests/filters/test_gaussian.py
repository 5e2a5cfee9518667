import numpy as np
import pytest

from concord.filters.gaussian import (
    Gaussian,
    to_gaussian,
    to_information,
)
from tests.filters.support import BATCHES, random_belief


@pytest.mark.parametrize("lanes", BATCHES)
def test_information_form_is_the_inverse_and_returns(lanes):
    belief = random_belief(np.random.default_rng(1), lanes, 4)
    information = to_information(belief)
    np.testing.assert_allclose(information.matrix, np.linalg.inv(belief.cov), rtol=1e-10)
    solved = np.linalg.solve(belief.cov, belief.mean[..., None])[..., 0]
    np.testing.assert_allclose(information.vector, solved, rtol=1e-10)
    returned = to_gaussian(information)
    np.testing.assert_allclose(returned.mean, belief.mean, rtol=1e-10)
    np.testing.assert_allclose(returned.cov, belief.cov, rtol=1e-10)


def test_a_lane_that_is_not_definite_is_nan_alone():
    mean, cov = random_belief(np.random.default_rng(3), (3,), 2)
    cov[1] = [[1.0, 2.0], [2.0, 1.0]]
    matrix = to_information(Gaussian(mean, cov)).matrix
    assert np.isnan(matrix[1]).all()
    assert np.isfinite(matrix[[0, 2]]).all()
