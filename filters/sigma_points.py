"""Sigma-point rules as values, and the points that a rule draws from a belief."""

import math
from dataclasses import dataclass

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky


@dataclass(frozen=True, eq=False)
class SigmaPointRule:
    """A quadrature rule for the standard normal distribution of n dimensions.

    The first point is the centre or, without one, as near to it as any: means are taken of
    differences to its value.
    """

    unit_points: np.ndarray  # (S, n), for mean 0 and covariance I
    mean_weights: np.ndarray  # (S,), sum 1
    cov_weights: np.ndarray  # (S,)


def scaled_unscented(
    n: int, alpha: float = 1.0, beta: float = 2.0, kappa: float | None = None
) -> SigmaPointRule:
    """The scaled unscented rule, S = 2 n + 1; kappa is 3 - n unless given.

    Source: Julier (2002), The scaled unscented transformation; weights as in Wan and Van der Merwe
    (2001), The unscented Kalman filter, with lambda = alpha^2 (n + kappa) - n.

    Raises:
        ValueError: n < 1, alpha <= 0, or n + kappa <= 0 (the points would be complex).
    """
    _check_dimension(n)
    kappa = 3.0 - n if kappa is None else kappa
    if not alpha > 0:
        raise ValueError(f"alpha is {alpha}, but it scales the spread: choose it in (0, 1]")
    if not n + kappa > 0:
        raise ValueError(
            f"kappa is {kappa} for n = {n}, but n + kappa must be positive: choose kappa > {-n}"
        )
    spread = alpha**2 * (n + kappa)  # n + lambda
    mean_weights = np.full(2 * n + 1, 0.5 / spread)
    mean_weights[0] = 1 - n / spread
    cov_weights = mean_weights.copy()
    cov_weights[0] += 1 - alpha**2 + beta
    axes = math.sqrt(spread) * np.eye(n)
    return SigmaPointRule(np.vstack([np.zeros(n), axes, -axes]), mean_weights, cov_weights)


def cubature(n: int) -> SigmaPointRule:
    """The third-degree spherical-radial rule, S = 2 n equal positive weights.

    Source: Arasaratnam and Haykin (2009), Cubature Kalman filters.

    Raises:
        ValueError: n < 1.
    """
    _check_dimension(n)
    axes = math.sqrt(n) * np.eye(n)
    weights = np.full(2 * n, 0.5 / n)
    return SigmaPointRule(np.vstack([axes, -axes]), weights, weights)


def sigma_points(belief: Gaussian, rule: SigmaPointRule) -> np.ndarray:
    """The points (S, ..., n) of a belief; NaN in a lane whose covariance is not positive definite.

    Raises:
        ValueError: the rule is for another dimension than the belief.
    """
    return spread_points(belief.mean, cholesky(belief.cov), rule)


def spread_points(mean: np.ndarray, factor: np.ndarray, rule: SigmaPointRule) -> np.ndarray:
    """Points mean + factor @ unit_point, (S, ..., n), of mean (..., n) and factor (..., n, n).

    Every component points[..., i] is contiguous, so that a model written component by component
    runs at memory speed, and its result keeps that order.

    Raises:
        ValueError: the rule is for another dimension than the mean.
    """
    check_rule(rule, mean.shape[-1])
    count, n = rule.unit_points.shape
    lanes = mean.shape[:-1]
    if factor.shape[:-2] != lanes:
        lanes = np.broadcast_shapes(lanes, factor.shape[:-2])
        factor = np.broadcast_to(factor, (*lanes, n, n))
    # Component i of all points is one product, (S, n) times (n, L).
    components = rule.unit_points @ factor.reshape(-1, n, n).transpose(1, 2, 0)
    points = components.reshape(n, count, *lanes).transpose(*range(1, len(lanes) + 2), 0)
    points += mean
    return points


def check_rule(rule: SigmaPointRule, states: int) -> None:
    """Refuse a rule for another dimension than the state's.

    Raises:
        ValueError: the rule is for another n.
    """
    n = rule.unit_points.shape[1]
    if states != n:
        raise ValueError(
            f"the sigma-point rule is for n = {n}, but the belief has n = {states}: "
            "make the rule with the dimension of the state"
        )


def _check_dimension(n: int) -> None:
    if n < 1:
        raise ValueError(f"n is {n}, but a state has at least one component")
