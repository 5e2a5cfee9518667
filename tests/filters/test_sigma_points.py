import itertools
import math

import numpy as np
import pytest

from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import cubature, scaled_unscented, sigma_points
from tests.filters.support import BATCHES, RULE_NAMES, random_belief, rules


def normal_moment(exponents: tuple[int, ...]) -> float:
    """E[prod x_i^e_i] for independent standard normals: products of double factorials."""
    if any(exponent % 2 for exponent in exponents):
        return 0.0
    return math.prod(math.prod(range(1, exponent, 2)) for exponent in exponents)


def quadrature(rule, exponents: tuple[int, ...]) -> float:
    return rule.mean_weights @ np.prod(rule.unit_points ** np.array(exponents), axis=-1)


@pytest.mark.parametrize("name", RULE_NAMES)
@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_every_rule_integrates_polynomials_of_degree_three(name, n):
    rule = rules(n)[name]
    for exponents in itertools.product(range(4), repeat=n):
        if sum(exponents) <= 3:
            expected = normal_moment(exponents)
            assert quadrature(rule, exponents) == pytest.approx(expected, abs=1e-12), exponents


@pytest.mark.parametrize("n", [1, 2, 3, 5, 7])
def test_fourth_moments_are_those_of_the_literature(n):
    fourth = (4,) + (0,) * (n - 1)
    assert quadrature(cubature(n), fourth) == pytest.approx(n)  # points at distance sqrt(n)
    assert quadrature(scaled_unscented(n), fourth) == pytest.approx(3)  # kappa = 3 - n: exact


@pytest.mark.parametrize("alpha", [1e-3, 0.3, 1.0])
@pytest.mark.parametrize("beta", [0.0, 2.0])
def test_beta_sets_the_variance_of_a_square(alpha, beta):
    # By hand for n = 1, kappa = 2: the rule's variance of x^2 is beta + 2 alpha^2; the truth is 2.
    rule = scaled_unscented(1, alpha, beta)
    deviation = rule.unit_points[:, 0] ** 2 - 1
    assert rule.cov_weights @ deviation**2 == pytest.approx(beta + 2 * alpha**2, abs=1e-8)


@pytest.mark.parametrize("name", RULE_NAMES)
@pytest.mark.parametrize("lanes", BATCHES)
def test_points_have_the_moments_of_the_belief(name, lanes):
    belief = random_belief(np.random.default_rng(1), lanes, 3)
    rule = rules(3)[name]
    points = sigma_points(belief, rule)
    assert points.shape == (len(rule.mean_weights), *lanes, 3)
    mean = np.einsum("s,s...i->...i", rule.mean_weights, points)
    deviations = points - belief.mean
    cov = np.einsum("s,s...i,s...j->...ij", rule.cov_weights, deviations, deviations)
    np.testing.assert_allclose(mean, belief.mean, atol=1e-12)
    np.testing.assert_allclose(cov, belief.cov, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", RULE_NAMES)
def test_the_first_point_is_as_near_to_the_centre_as_any(name):
    distances = np.linalg.norm(rules(3)[name].unit_points, axis=-1)
    assert distances[0] == pytest.approx(distances.min())


@pytest.mark.parametrize("lanes", BATCHES)
def test_each_component_is_contiguous_for_the_model(lanes):
    points = sigma_points(random_belief(np.random.default_rng(1), lanes, 3), cubature(3))
    assert all(points[..., i].flags.c_contiguous for i in range(3))


def test_a_shared_covariance_serves_all_lanes():
    generator = np.random.default_rng(4)
    mean, cov = generator.standard_normal((6, 3)), random_belief(generator, (), 3).cov
    points = sigma_points(Gaussian(mean, cov), cubature(3))  # six lanes, six points: no mix-up
    for lane in range(6):
        expected = sigma_points(Gaussian(mean[lane], cov), cubature(3))
        np.testing.assert_allclose(points[:, lane], expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: scaled_unscented(0), "n is 0"),
        (lambda: cubature(-1), "n is -1"),
        (lambda: scaled_unscented(3, alpha=0.0), "alpha is 0"),
        (lambda: scaled_unscented(3, alpha=math.nan), "alpha is nan"),
        (lambda: scaled_unscented(3, kappa=-3.0), "kappa is -3"),
    ],
)
def test_parameters_without_a_rule_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_rule_of_another_dimension_is_refused():
    with pytest.raises(ValueError, match="n = 4, but the belief has n = 3"):
        sigma_points(random_belief(np.random.default_rng(1), (), 3), cubature(4))
