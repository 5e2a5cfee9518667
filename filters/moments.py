"""Weighted moments of what a model returned for the sigma points."""

from collections.abc import Callable

import numpy as np

from concord.filters.sigma_points import SigmaPointRule

Model = Callable[[np.ndarray], np.ndarray]  # points (S, ..., n) -> values (S, ..., m)
Residual = Callable[[np.ndarray, np.ndarray], np.ndarray]  # difference, angles wrapped


def evaluate(model: Model, points: np.ndarray, size: int, name: str) -> np.ndarray:
    """The model's values (S, ..., size) at the points; `name` is what an error calls the model.

    Raises:
        ValueError: the model returned another shape.
    """
    values = np.asarray(model(points))
    if values.shape != (*points.shape[:-1], size):
        raise ValueError(
            f"{name} returned shape {values.shape} for points of shape {points.shape}, but it must "
            f"keep the leading axes and return {size} components (the noise covariance and the "
            "measurement have that size): index components as points[..., i], never points[i]"
        )
    return values


def moments(
    values: np.ndarray, rule: SigmaPointRule, residual: Residual
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (..., m) of values (S, ..., m), and their deviations from it, (..., S, m)."""
    mean = weighted_mean(values, rule, residual)
    return mean, points_last(residual(values, mean))


def weighted_mean(values: np.ndarray, rule: SigmaPointRule, residual: Residual) -> np.ndarray:
    """Return sum_s w_s Y_s (..., m) of values Y (S, ..., m).

    The sum is taken of residuals to the first value, so that angles near the wrap average properly.
    """
    first = values[0]
    return first + np.einsum("s,s...i->...i", rule.mean_weights, residual(values, first))


def weigh(values: np.ndarray, rule: SigmaPointRule) -> np.ndarray:
    """Return w_s Y_s (S, ..., m) of values Y (S, ..., m), with the weights of covariances."""
    return (values.T * rule.cov_weights).T


def sum_of_products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return sum_s L_s R_s' (..., n, m) of L (S, ..., n) and R (S, ..., m)."""
    return np.einsum("s...i,s...j->...ij", left, right)


def points_last(values: np.ndarray) -> np.ndarray:
    """Values (S, ..., m) with the sigma axis next to the components: (..., S, m)."""
    if values.ndim == 2:
        return values
    # BLAS takes any row distance but wants unit stride inside a row.
    values = np.ascontiguousarray(values)
    return values.transpose(*range(1, values.ndim - 1), 0, values.ndim - 1)


def check_noise(noise: np.ndarray, size: int, name: str) -> None:
    """Refuse a noise matrix that numpy would silently broadcast.

    Raises:
        ValueError: the last two axes are not (size, size).
    """
    if noise.shape[-2:] != (size, size):
        raise ValueError(
            f"{name} has shape {noise.shape}, but must end in ({size}, {size}): "
            "pass a matrix, for independent noises numpy.diag(variances)"
        )
