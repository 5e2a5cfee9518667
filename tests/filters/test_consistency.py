import numpy as np
import pytest
from scipy.stats import chi2

from filters import ukf
from filters.gaussian import Gaussian
from filters.sigma_points import scaled_unscented

LANES, STEPS = 400, 40
F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = 0.05 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
R = np.array([[4.0]])
START_COV = np.diag([9.0, 1.0])
BAND = (1e-5, 1 - 1e-5)


def simulate(assumed_noise: np.ndarray) -> tuple[float, float]:
    """Normalised squares, summed: errors of the last step, innovations of all, over all lanes."""
    generator = np.random.default_rng(20)
    rule = scaled_unscented(2)
    truth = generator.multivariate_normal(np.zeros(2), START_COV, LANES)
    belief = Gaussian(np.zeros((LANES, 2)), np.broadcast_to(START_COV, (LANES, 2, 2)))
    innovations_squared = 0.0
    for _ in range(STEPS):
        truth = truth @ F.T + generator.multivariate_normal(np.zeros(2), Q, LANES)
        measurement = truth[:, :1] + 2.0 * generator.standard_normal((LANES, 1))
        belief = ukf.predict(belief, lambda x: x @ F.T, Q, rule)
        update = ukf.update(belief, measurement, lambda x: x[..., :1], assumed_noise, rule)
        belief = update.belief
        innovations_squared += update.normalised_innovation_squared.sum()
    error = truth - belief.mean
    errors_squared = (error * np.linalg.solve(belief.cov, error[..., None])[..., 0]).sum()
    return errors_squared, innovations_squared


def test_a_matched_filter_is_consistent():
    errors_squared, innovations_squared = simulate(R)
    low, high = chi2.ppf(BAND, 2 * LANES)
    assert low < errors_squared < high
    low, high = chi2.ppf(BAND, LANES * STEPS)  # innovations are white: their squares add up
    assert low < innovations_squared < high


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_band_is_narrow_enough_to_see_a_mismatch(factor):
    _, innovations_squared = simulate(factor * R)
    low, high = chi2.ppf(BAND, LANES * STEPS)
    assert not low < innovations_squared < high
