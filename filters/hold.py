"""Fusion weights when a neighbour was silent: what its held share is still worth.

Every function takes `base_weights` (..., J), a node's row of the weight matrix (sum 1), and `ages`
(..., J), the communication cycles since each share was published: 0 in the present cycle, negative
if never heard. The node itself is entry 0 and has age 0. Every result (..., J) is non-negative and
sums to 1; where no weight at all is left, the node keeps its own belief.

Which variants are consistent depends on what is held: a held belief must be predicted once per step
(control and process noise included), unless it is used within the step of its publication; held as
it was, it is an estimate of an older state, and every rule loses consistency.
"""

import numpy as np

from filters.linalg import cholesky


def held_weights(
    base_weights: np.ndarray,
    ages: np.ndarray,
    covs: np.ndarray,
    decay: float,
    determinant_weights: bool,
) -> np.ndarray:
    """Weights proportional to base_j decay^age_j |P_j|^(-1/n), for predicted held beliefs.

    A decay of 0 is `renormalise`, a decay of 1 is `full`. The determinant factor favours sharp
    beliefs; only its ratios matter, so it does not depend on the units of the state.

    Args:
        base_weights: (..., J), sum 1.
        ages: (..., J), cycles; negative: never heard.
        covs: (..., J, n, n), predicted to now; those never heard may be anything, NaN included.
        decay: factor per cycle of age, 0 to 1.
        determinant_weights: whether |P_j|^(-1/n) takes part.

    Returns:
        (..., J); NaN in a lane where a covariance that counts is not positive definite.

    Raises:
        ValueError: decay is outside [0, 1].
    """
    if not 0 <= decay <= 1:
        raise ValueError(f"decay is {decay}, but a share does not gain by age: choose 0 to 1")
    worth = _left_to_self(_where_heard(base_weights, ages) * decay ** np.maximum(ages, 0.0))
    if determinant_weights:
        worth = worth * _sharpness(covs, worth > 0)
    return worth / worth.sum(axis=-1, keepdims=True)


def full(base_weights: np.ndarray, ages: np.ndarray) -> np.ndarray:
    """Every held share at full weight, whatever its age; only those never heard are left out."""
    return _normalise(_where_heard(base_weights, ages))


def renormalise(base_weights: np.ndarray, ages: np.ndarray) -> np.ndarray:
    """Only shares of the present cycle and the node itself, scaled to sum 1."""
    return _normalise(np.where(ages == 0, base_weights, 0.0))


def in_step(base_weights: np.ndarray, ages: np.ndarray, cycles_in_step: int) -> np.ndarray:
    """Shares published within this time step, held as they were, scaled to sum 1.

    Args:
        base_weights: (..., J), sum 1.
        ages: (..., J), cycles; negative: never heard.
        cycles_in_step: cycles since the step began; 0 in its first, which makes it `renormalise`.
    """
    return _normalise(np.where(ages <= cycles_in_step, _where_heard(base_weights, ages), 0.0))


def drop(base_weights: np.ndarray, ages: np.ndarray) -> np.ndarray:
    """Only shares of the present cycle; the weight of the silent falls back to the node itself."""
    present = ages == 0
    weights = np.where(present, base_weights, 0.0)
    weights[..., 0] += np.where(present, 0.0, base_weights).sum(axis=-1)
    return weights


def _where_heard(base_weights: np.ndarray, ages: np.ndarray) -> np.ndarray:
    return np.where(ages < 0, 0.0, base_weights)


def _left_to_self(worth: np.ndarray) -> np.ndarray:
    """All weight to entry 0 in lanes where none is left."""
    alone = np.eye(worth.shape[-1])[0]
    return np.where((worth > 0).any(axis=-1, keepdims=True), worth, alone)


def _normalise(worth: np.ndarray) -> np.ndarray:
    worth = _left_to_self(worth)
    return worth / worth.sum(axis=-1, keepdims=True)


def _sharpness(covs: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """|P_j|^(-1/n) (..., J) where P_j counts; the determinant itself could overflow."""
    n = covs.shape[-1]
    factor = cholesky(np.where(counts[..., None, None], covs, np.eye(n)))
    half_log_determinant = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.exp(-2.0 / n * half_log_determinant)
