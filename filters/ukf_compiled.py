"""The unscented transform by compiled kernels, for batches of any size, in the order of
`ukf_columns`: lanes last, and models that see a view (S, ..., n)."""

import numpy as np

from filters import ukf_columns
from filters.compiled import KERNELS, lanes_first
from filters.gaussian import Gaussian
from filters.moments import Model, Residual, evaluate
from filters.sigma_points import SigmaPointRule, check_rule


def predict(
    belief: Gaussian,
    transition: Model,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual,
) -> Gaussian:
    """As `ukf.predict`."""
    lanes, n = belief.mean.shape[:-1], belief.mean.shape[-1]
    points = _spread(belief, rule, None)
    values = evaluate(transition, points, n, "transition")
    first, away, plain = _differences(values, rule, residual)
    mean, cov, weight = np.empty((n, *lanes)), np.empty((n, n, *lanes)), rule.cov_weights.item(-1)
    KERNELS.moments(first, away, plain, weight, rule.curvature, noise_cov, mean, cov)
    return Gaussian(lanes_first(mean, 1), lanes_first(cov, 2))


def expect(
    belief: Gaussian,
    measure: Model,
    m: int,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual,
    state_residual: Residual,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predicted measurement (..., m); covariances (..., m, m) of it, (..., n, m) with the state."""
    if state_residual is not np.subtract:
        return ukf_columns.expect(belief, measure, m, noise_cov, rule, residual, state_residual)
    lanes, n = belief.mean.shape[:-1], belief.mean.shape[-1]
    factor = np.empty((n, n, *lanes))
    points = _spread(belief, rule, factor)
    values = evaluate(measure, points, m, "measure")
    first, away, plain = _differences(values, rule, residual)
    predicted, cov = np.empty((m, *lanes)), np.empty((m, m, *lanes))
    cross_cov = np.empty((n, m, *lanes))
    weight = rule.cov_weights.item(-1)
    KERNELS.expect(
        *(first, away, plain, weight, rule.curvature, noise_cov, factor, weight * rule.reach),
        *(predicted, cov, cross_cov),
    )
    return lanes_first(predicted, 1), lanes_first(cov, 2), lanes_first(cross_cov, 2)


def correct(
    belief: Gaussian, innovation: np.ndarray, innovation_cov: np.ndarray, cross_cov: np.ndarray
) -> tuple[Gaussian, np.ndarray]:
    """The belief given an innovation (..., m), and the normalised innovation squared (...)."""
    lanes, n = belief.mean.shape[:-1], belief.mean.shape[-1]
    mean, cov, squared = np.empty((n, *lanes)), np.empty((n, n, *lanes)), np.empty(lanes)
    KERNELS.correct(*belief, innovation, innovation_cov, cross_cov, mean, cov, squared)
    return Gaussian(lanes_first(mean, 1), lanes_first(cov, 2)), squared


def _spread(belief: Gaussian, rule: SigmaPointRule, factor: np.ndarray | None) -> np.ndarray:
    """Sigma points (S, ..., n); writes the lower triangle of the factor (n, n, ...) they are drawn
    with, if one is given."""
    lanes, n = belief.mean.shape[:-1], belief.mean.shape[-1]
    check_rule(rule, n)
    points = np.empty((n, len(rule.unit_points), *lanes))
    KERNELS.spread(*belief, rule.reach, points, factor)
    return lanes_first(points, 1)


def _differences(
    values: np.ndarray, rule: SigmaPointRule, residual: Residual
) -> tuple[np.ndarray, np.ndarray, bool]:
    """The first value (..., m), and the differences of the others to it (2 n, ..., m); or those
    others, and True, where a difference is plain and the kernel takes it."""
    first, away = values[0], values[-2 * rule.unit_points.shape[1] :]
    if residual is np.subtract:
        return first, away, True
    return first, residual(away, first), False
