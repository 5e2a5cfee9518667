"""The unscented transform of a single lane, for a node of its own.

At this size nothing counts but the number of calls into numpy, so everything is a product of two
small matrices, and a small matrix is factored in plain numbers.
"""

import math

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import symmetrise
from filters.moments import Model, Residual, evaluate
from filters.plain_cholesky import ROWS, plain_cholesky
from filters.sigma_points import SigmaPointRule, check_rule


def predict(
    belief: Gaussian,
    transition: Model,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual,
) -> Gaussian:
    """As `ukf.predict`, for a batch of one lane."""
    shape = belief.mean.shape
    n = shape[-1]
    points, _ = _spread(belief, rule)
    values = evaluate(transition, points, n, "transition")
    mean, cov, _, _ = _moments(values, n, noise_cov, rule, residual)
    return _in_lanes(shape, mean, cov)


def expect(
    belief: Gaussian,
    measure: Model,
    m: int,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual,
    state_residual: Residual,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predicted measurement (..., m); covariances (..., m, m) of it, (..., n, m) with the state.

    For a batch of one lane.
    """
    lanes, n = belief.mean.shape[:-1], belief.mean.shape[-1]
    points, factor = _spread(belief, rule)
    values = evaluate(measure, points, m, "measure")
    predicted, cov, away, taken = _moments(values, m, noise_cov, rule, residual)
    if state_residual is np.subtract:
        cross_cov = factor.dot(taken[:n])
    else:
        state_away = state_residual(points, belief.mean).reshape(-1, n)
        cross_cov = (state_away[1:].T * rule.cov_weights[1:]).dot(away)
        cross_cov -= np.outer(rule.cov_weights.dot(state_away), taken[n])
    if lanes:
        predicted, cov = predicted.reshape(*lanes, m), cov.reshape(*lanes, m, m)
        cross_cov = cross_cov.reshape(*lanes, n, m)
    return predicted, cov, cross_cov


def correct(
    belief: Gaussian, innovation: np.ndarray, innovation_cov: np.ndarray, cross_cov: np.ndarray
) -> tuple[Gaussian, np.ndarray]:
    """The belief given an innovation (..., m), and the normalised innovation squared (...); for a
    batch of one lane."""
    shape, m = belief.mean.shape, innovation.shape[-1]
    n = shape[-1]
    whitener = _whitener(innovation_cov.reshape(m, m))
    whitened = whitener.dot(innovation.reshape(m))
    gain = cross_cov.reshape(n, m).dot(whitener.T)
    mean = belief.mean.reshape(n) + gain.dot(whitened)
    cov = belief.cov.reshape(n, n) - gain.dot(gain.T)
    squared = whitened.dot(whitened)
    return _in_lanes(shape, mean, cov), np.asarray(squared).reshape(shape[:-1])


def _in_lanes(shape: tuple[int, ...], mean: np.ndarray, cov: np.ndarray) -> Gaussian:
    """A belief of mean (n,) and cov (n, n), its mean in this shape (..., n)."""
    if len(shape) == 1:
        return Gaussian(mean, cov)
    return Gaussian(mean.reshape(shape), cov.reshape(*shape, len(mean)))


def _spread(belief: Gaussian, rule: SigmaPointRule) -> tuple[np.ndarray, np.ndarray]:
    """Sigma points (S, ..., n), and the factor (n, n) that they were drawn with."""
    shape = belief.mean.shape
    n = shape[-1]
    check_rule(rule, n)
    factor = _factor(belief.cov.reshape(n, n))
    points = rule.unit_points.dot(factor.T)
    points += belief.mean.reshape(n)
    return points if len(shape) == 1 else points.reshape(-1, *shape), factor


def _moments(
    values: np.ndarray, size: int, noise_cov: np.ndarray, rule: SigmaPointRule, residual: Residual
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mean (size,), cov (size, size), differences (S - 1, size), and what is taken of them: first
    the products with weighted unit points (n, size), then the shift of the mean."""
    first, n = values[0], rule.unit_points.shape[1]
    away = residual(values[1:], first)
    if away.ndim > 2:
        away, first = away.reshape(-1, size), first.reshape(size)
    if (of_differences := rule.of_differences) is None:
        weights = rule.cov_weights[1:]
        shift = weights.dot(away)
        cov = symmetrise((away.T * weights).dot(away) + rule.curvature * np.outer(shift, shift))
        taken = np.vstack((rule.weighted_unit_points.dot(away), shift))
    else:
        taken = of_differences.dot(away)
        shift, rows = taken[n], taken[n + 1 :]
        cov = rows.T.dot(rows)
    cov += noise_cov.reshape(size, size)
    return first + shift, cov, away, taken


def _factor(cov: np.ndarray) -> np.ndarray:
    """Lower triangular factor (n, n); NaN where there is none."""
    try:
        plain = len(cov) <= ROWS
        factor = np.array(plain_cholesky(cov.tolist())) if plain else np.linalg.cholesky(cov)
    except (ValueError, ZeroDivisionError):
        return np.full(cov.shape, np.nan)
    # The last pivot may still be zero, or the NaN that was carried through to it.
    return factor if factor.item(-1) > 0 else np.full(cov.shape, np.nan)


def _whitener(cov: np.ndarray) -> np.ndarray:
    """Inverse (m, m) of the Cholesky factor; NaN where there is none."""
    if len(cov) > 2:
        return np.linalg.inv(_factor(cov))
    first = cov.item(0)
    if not first > 0:
        return np.full(cov.shape, np.nan)
    first = 1.0 / math.sqrt(first)
    if len(cov) == 1:
        return np.array([[first]])
    across = cov.item(2) * first
    second = cov.item(3) - across * across
    if not second > 0:
        return np.full(cov.shape, np.nan)
    second = 1.0 / math.sqrt(second)
    return np.array([[first, 0.0], [-across * first * second, second]])
