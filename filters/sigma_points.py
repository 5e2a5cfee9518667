"""Sigma-point rules as values, and the points that a rule draws from a belief."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import cholesky


@dataclass(frozen=True, eq=False)
class SigmaPointRule:
    """A quadrature rule for the standard normal distribution of n dimensions.

    The first point is the centre or, without one, as near to it as any: `moments` refers to it. The
    others have weights that are positive, and alike for mean and covariance.

    Moments are taken of differences to the first point's value, D_s = Y_s - Y_0: with d the mean of
    those, x = Y_0 + d and P = sum_s w_s D_s D_s' + curvature d d'. No weight under a root or a sum
    of squares is then negative, nothing near Y_0 cancels, and no pass subtracts the mean.

    Raises:
        ValueError: a weight beyond the first is not positive, or not alike for both moments.
    """

    unit_points: np.ndarray  # (S, n), for mean 0 and covariance I
    mean_weights: np.ndarray  # (S,), sum 1
    cov_weights: np.ndarray  # (S,)

    def __post_init__(self) -> None:
        outer = self.cov_weights[1:]
        if not (outer > 0).all() or not np.array_equal(outer, self.mean_weights[1:]):
            raise ValueError(
                f"weights beyond the first point are {self.mean_weights[1:]} for the mean and "
                f"{outer} for the covariance, but must be positive and alike: only the first "
                "point may weigh otherwise"
            )

    @cached_property
    def roots(self) -> np.ndarray:
        """Square roots of the weights beyond the first point: (S - 1,)."""
        return np.sqrt(self.cov_weights[1:])

    @cached_property
    def weighted_unit_points(self) -> np.ndarray:
        """Unit points beyond the first, times their weights, one per column: (n, S - 1)."""
        return np.ascontiguousarray((self.cov_weights[1:, None] * self.unit_points[1:]).T)

    @cached_property
    def moment_root(self) -> np.ndarray | None:
        """T (S - 1, S - 1) with P = (T D)' T D for D of rows D_s; None where P need not be positive
        semi-definite, as the first point weighs too little."""
        quadratic = np.diag(self.cov_weights[1:])
        quadratic += self.curvature * np.outer(self.mean_weights[1:], self.mean_weights[1:])
        try:
            return np.ascontiguousarray(np.linalg.cholesky(quadratic).T)
        except np.linalg.LinAlgError:
            return None

    @cached_property
    def of_differences(self) -> np.ndarray | None:
        """All that a step takes of differences, in one product: the weighted unit points, the
        weights beyond the first, and `moment_root`; None where that is none. (n + S, S - 1)."""
        if self.moment_root is None:
            return None
        return np.vstack((self.weighted_unit_points, self.mean_weights[1:], self.moment_root))

    @cached_property
    def curvature(self) -> float:
        """Weight of d d' in the covariance."""
        return float(self.cov_weights.sum()) - 2.0

    @cached_property
    def reach(self) -> float | None:
        """Length g of points +-g on the axes, in that order after a centre if there is one, all of
        one weight; None for a rule of another shape."""
        n = self.unit_points.shape[1]
        reach = float(self.unit_points[-2 * n, 0]) if len(self.unit_points) >= 2 * n else 0.0
        axes = reach * np.eye(n)
        points = np.vstack([axes, -axes])
        if len(self.unit_points) == 2 * n + 1:
            points = np.vstack([np.zeros(n), points])
        alike = (self.cov_weights[-2 * n :] == self.cov_weights[-1]).all()
        return reach if np.array_equal(self.unit_points, points) and alike else None


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


def gauss_hermite(n: int, order: int) -> SigmaPointRule:
    """The tensor product of the Gauss-Hermite rule, S = order^n, exact to degree 2 order - 1.

    Source: Ito and Xiong (2000), Gaussian filters for nonlinear filtering problems.

    Raises:
        ValueError: n < 1, or order < 2 (a single point has no spread).
    """
    _check_dimension(n)
    if order < 2:
        raise ValueError(f"order is {order}, but one point has no spread: choose order >= 2")
    nodes, line_weights = np.polynomial.hermite_e.hermegauss(order)
    index = np.indices((order,) * n).reshape(n, -1).T
    weights = np.prod(line_weights[index] / math.sqrt(2 * math.pi), axis=-1)
    heaviest_first = np.argsort(-weights, kind="stable")
    weights = weights[heaviest_first]
    return SigmaPointRule(nodes[index[heaviest_first]], weights, weights)


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
    depth = len(lanes)
    offsets = (factor @ rule.unit_points.T).transpose(depth + 1, *range(depth + 1))
    points = np.empty((n, count, *lanes)).transpose(*range(1, depth + 2), 0)
    return np.add(mean, offsets, out=points)


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
