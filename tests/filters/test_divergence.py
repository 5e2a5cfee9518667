"""The Kullback-Leibler divergence, against its integral and its invariants."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from concord.filters.gaussian import Gaussian
from concord.nodes.rules.labelled.source_gate import kullback_leibler


def random_belief(rng: np.random.Generator, n: int) -> Gaussian:
    root = rng.normal(size=(n, n))
    return Gaussian(rng.normal(size=n), root @ root.T + 0.1 * np.eye(n))


@pytest.mark.parametrize("mean, std", [(0.0, 1.0), (0.7, 0.4), (-2.0, 1.9)])
def test_one_state_has_the_divergence_of_the_integral(mean: float, std: float):
    expected, _ = quad(
        lambda x: norm.pdf(x, mean, std) * (norm.logpdf(x, mean, std) - norm.logpdf(x, 0.3, 1.1)),
        mean - 12 * std,
        mean + 12 * std,
    )
    found = kullback_leibler(
        Gaussian(np.array([mean]), np.array([[std**2]])),
        Gaussian(np.array([0.3]), np.array([[1.1**2]])),
    )
    assert found == pytest.approx(expected, abs=1e-9)


def test_coordinates_do_not_matter_and_independent_parts_add_up():
    rng = np.random.default_rng(3)
    one, other = random_belief(rng, 4), random_belief(rng, 4)
    change = rng.normal(size=(4, 4))
    moved = [Gaussian(change @ b.mean + 2.0, change @ b.cov @ change.T) for b in (one, other)]
    assert kullback_leibler(*moved) == pytest.approx(kullback_leibler(one, other), rel=1e-8)
    assert kullback_leibler(one, one) == pytest.approx(0, abs=1e-12)
    zero = np.zeros((4, 4))
    pairs = [
        Gaussian(np.tile(b.mean, 2), np.block([[b.cov, zero], [zero, b.cov]])) for b in (one, other)
    ]
    assert kullback_leibler(*pairs) == pytest.approx(2 * kullback_leibler(one, other), rel=1e-9)
    lanes = Gaussian(np.stack([one.mean, other.mean]), np.stack([one.cov, other.cov]))
    both = kullback_leibler(lanes, other)
    np.testing.assert_allclose(both, [float(kullback_leibler(one, other)), 0.0], atol=1e-9)
