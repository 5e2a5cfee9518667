"""The unscented transform of many lanes, lanes last, for rules whose points lie on the axes.

Every array is a structure of arrays (`filters/columns.py`), so that each operation runs along
contiguous lanes; a model sees its points as a view (S, ..., n) in which `points[..., i]` is
contiguous, and what it computes component by component comes back in the same order.
"""

import numpy as np

from filters.columns import eliminate, in_columns, in_rows, mirror
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
    points, _ = _spread(belief, rule)
    values = evaluate(transition, points, n, "transition")
    cov = np.empty((n, n, points[0, ..., 0].size))
    mean, _ = _moments(values, noise_cov, rule, residual, cov)
    return Gaussian(in_rows(mean, lanes), in_rows(mirror(cov), lanes))


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
    lanes, n = belief.mean.shape[:-1], belief.mean.shape[-1]
    points, factor = _spread(belief, rule)
    values = evaluate(measure, points, m, "measure")
    cov = np.empty((m, m, points[0, ..., 0].size))
    predicted, away = _moments(values, noise_cov, rule, residual, cov)
    weight = rule.cov_weights[-1]
    cross_cov = np.empty((n, m, cov.shape[-1]))
    if state_residual is np.subtract:
        # The points are +-g times the factor's columns, so opposite differences go together.
        halves = away[:, :n] - away[:, n:]
        halves *= weight * rule.reach
        for i in range(n):
            np.einsum("jl,mjl->ml", factor[i, : i + 1], halves[:, : i + 1], out=cross_cov[i])
    else:
        state_away = in_columns(state_residual(points, belief.mean), 1)
        state_away = state_away.reshape(n, len(points), -1)
        shift = predicted - in_columns(values[0], 1)
        for i in range(n):
            np.einsum("sl,msl->ml", state_away[i, -2 * n :], away, out=cross_cov[i])
            pull = np.einsum("s,sl->l", rule.cov_weights, state_away[i])
            cross_cov[i] = weight * cross_cov[i] - pull * shift
    return in_rows(predicted, lanes), in_rows(mirror(cov), lanes), in_rows(cross_cov, lanes)


def correct(
    belief: Gaussian, innovation: np.ndarray, innovation_cov: np.ndarray, cross_cov: np.ndarray
) -> tuple[Gaussian, np.ndarray]:
    """The belief given an innovation (..., m), and the normalised innovation squared (...)."""
    lanes, n, m = belief.mean.shape[:-1], belief.mean.shape[-1], innovation.shape[-1]
    before = in_columns(belief.cov, 2)
    rows = np.empty((m + n + 1, m, before.shape[-1]))
    rows[:m] = in_columns(innovation_cov, 2)
    rows[m:-1] = in_columns(cross_cov, 2)
    rows[-1] = in_columns(innovation, 1)
    eliminate(rows, m)
    gain, whitened = rows[m:-1], rows[-1]
    mean = in_columns(belief.mean, 1) + np.einsum("nml,ml->nl", gain, whitened)
    cov = np.empty(before.shape)
    for i in range(n):
        row = np.einsum("ml,jml->jl", gain[i], gain[: i + 1], out=cov[i, : i + 1])
        np.subtract(before[i, : i + 1], row, out=row)
    squared = np.einsum("ml,ml->l", whitened, whitened)
    return Gaussian(in_rows(mean, lanes), in_rows(mirror(cov), lanes)), squared.reshape(lanes)


def _spread(belief: Gaussian, rule: SigmaPointRule) -> tuple[np.ndarray, np.ndarray]:
    """Sigma points (S, ..., n), and the factor (n, n, L) that they were drawn with."""
    lanes, n = belief.mean.shape[:-1], belief.mean.shape[-1]
    check_rule(rule, n)
    mean, factor = in_columns(belief.mean, 1), in_columns(belief.cov, 2).copy()
    eliminate(factor, n)
    failed = np.isnan(factor[-1, -1])
    if failed.any():
        mean = np.where(failed, np.nan, mean)
    points = np.empty((n, len(rule.unit_points), mean.shape[-1]))
    points[:, 0] = mean
    ahead, behind = points[:, -2 * n : -n], points[:, -n:]
    for j in range(n):
        ahead[:j, j] = behind[:j, j] = mean[:j]
        offset = rule.reach * factor[j:, j]
        np.add(mean[j:], offset, out=ahead[j:, j])
        np.subtract(mean[j:], offset, out=behind[j:, j])
    shaped = points.reshape(n, -1, *lanes)
    return shaped.transpose(*range(1, shaped.ndim), 0), factor


def _moments(
    values: np.ndarray,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual,
    cov: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (m, L) and differences (m, 2 n, L) to the first value; writes the lower triangle of cov
    (m, m, L)."""
    axes = 2 * rule.unit_points.shape[1]
    m, lanes = len(cov), cov.shape[-1]
    last_first = values.transpose(values.ndim - 1, *range(values.ndim - 1))
    if residual is np.subtract:
        away = np.subtract(last_first[:, -axes:], last_first[:, :1], order="C")
    else:
        away = in_columns(residual(values[-axes:], values[0]), 1)
    away = away.reshape(m, axes, lanes)
    weight = rule.cov_weights[-1]
    shift = weight * np.einsum("msl->ml", away)
    noise = in_columns(noise_cov, 2)
    for i in range(m):
        row = np.einsum("sl,jsl->jl", away[i], away[: i + 1], out=cov[i, : i + 1])
        row *= weight
        row += (rule.curvature * shift[i]) * shift[: i + 1]
        row += noise[i, : i + 1]
    return last_first[:, 0].reshape(m, lanes) + shift, away
