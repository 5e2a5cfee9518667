"""The unscented transform of a few lanes, lanes first: stacked products of small matrices.

Also that of many lanes where the rule's points do not lie on the axes.
"""

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import cholesky, multiply
from filters.moments import Model, Residual, evaluate, points_last
from filters.sigma_points import SigmaPointRule, spread_points


def predict(
    belief: Gaussian,
    transition: Model,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual,
) -> Gaussian:
    """As `ukf.predict`."""
    points = spread_points(belief.mean, cholesky(belief.cov), rule)
    values = evaluate(transition, points, belief.mean.shape[-1], "transition")
    mean, cov, _, _ = _moments(values, noise_cov, rule, residual)
    return Gaussian(mean, cov)


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
    factor = cholesky(belief.cov)
    points = spread_points(belief.mean, factor, rule)
    values = evaluate(measure, points, m, "measure")
    predicted, cov, rows, shift = _moments(values, noise_cov, rule, residual)
    if state_residual is np.subtract:
        return predicted, cov, factor @ (rule.weighted_unit_points / rule.roots @ rows)
    away = points_last(state_residual(points, belief.mean))
    cross_cov = (rule.roots[:, None] * away[..., 1:, :]).mT @ rows
    cross_cov -= (rule.cov_weights @ away)[..., :, None] * shift[..., None, :]
    return predicted, cov, cross_cov


def correct(
    belief: Gaussian, innovation: np.ndarray, innovation_cov: np.ndarray, cross_cov: np.ndarray
) -> tuple[Gaussian, np.ndarray]:
    """The belief given an innovation (..., m), and the normalised innovation squared (...)."""
    # With S = C C', the whitened gain G = K C = P_xz C^-T makes the posterior P - G G', which is
    # symmetric as it is computed, and needs no inverse but that of a triangle.
    whitener = np.linalg.inv(cholesky(innovation_cov))
    whitened = multiply(whitener, innovation)
    gain = cross_cov @ whitener.mT
    after = Gaussian(belief.mean + multiply(gain, whitened), belief.cov - gain @ gain.mT)
    return after, np.vecdot(whitened, whitened)


def _moments(
    values: np.ndarray, noise_cov: np.ndarray, rule: SigmaPointRule, residual: Residual
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mean (..., m), cov (..., m, m), weighted differences (..., S - 1, m), shift of the mean."""
    first = values[0]
    rows = points_last(residual(values[1:], first)) * rule.roots[:, None]
    shift = rule.roots @ rows
    cov = rows.mT @ rows
    cov += rule.curvature * shift[..., :, None] * shift[..., None, :]
    cov = cov + noise_cov
    return first + shift, cov, rows, shift
