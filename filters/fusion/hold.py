"""Fusion weights when a neighbour was silent: what its held share is still worth.

Every function takes `base_weights` (..., J), a node's row of the weight matrix (sum 1), and `ages`
(..., J), the communication cycles since each share was published: 0 in the present cycle, negative
if never heard. The node itself is entry 0 and has age 0. Every result (..., J) is non-negative and
sums to 1; where no weight at all is left, the node keeps its own belief.

The held belief decides which variants are consistent. A held belief must be predicted once per step
(control and process noise included), unless it is used within the step of its publication. A held
belief without prediction estimates an older state, and every rule then loses consistency.
"""

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky


def check_weights(weights: np.ndarray) -> None:
    """Refuse weights (..., J) that are not averages; NaN passes, for it marks a failed lane.

    Raises:
        ValueError: a weight is negative, or they do not sum to 1 within 1e-9.
    """
    total = weights.sum(axis=-1)
    if (weights < 0).any() or (np.abs(total - 1) > 1e-9).any():
        raise ValueError(
            f"weights must be non-negative and sum to 1 over the last axis, but the least is "
            f"{np.nanmin(weights)} and the sums span {np.nanmin(total)} to {np.nanmax(total)}: "
            "normalise them, for instance with hold.renormalise"
        )


def held_weights(
    base_weights: np.ndarray,
    ages: np.ndarray,
    decay: float,
    inverse_volume: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Weights proportional to base_j decay^age_j inverse_volume_j, for predicted held beliefs.

    A decay of 0 is `renormalise`, a decay of 1 is `full`.

    Args:
        base_weights: (..., J), sum 1.
        ages: (..., J), cycles; negative: never heard.
        decay: factor per cycle of age, 0 to 1.
        inverse_volume: (..., J), as the function `inverse_volume` returns it; the entry of a
            neighbour never heard may be anything. By default all beliefs weigh alike, whatever
            their volume.

    Returns:
        (..., J); NaN in a lane where the inverse volume of a belief that counts is NaN.

    Raises:
        ValueError: decay is outside [0, 1].
    """
    if not 0 <= decay <= 1:
        raise ValueError(f"decay is {decay}, but a share does not gain by age: choose 0 to 1")
    worth = _left_to_self(_where_heard(base_weights, ages) * decay ** np.maximum(ages, 0.0))
    return times_inverse_volume(worth, inverse_volume)


def times_inverse_volume(weights: np.ndarray, inverse_volume: np.ndarray | float) -> np.ndarray:
    """Multiply weights (..., J) by inverse volumes (..., J) where they exist; scale to sum 1."""
    worth = weights * np.where(weights > 0, inverse_volume, 0.0)
    return worth / np.add.reduce(worth, axis=-1, keepdims=True)


def inverse_volume(covs: np.ndarray) -> np.ndarray:
    """|P|^(-1/n) (...) of covariances (..., n, n); NaN where one is not positive definite.

    As a factor of a weight it favours sharp beliefs; only ratios matter there, so it does not
    depend on the units of the state.
    """
    return inverse_volume_of_factor(cholesky(covs))


def inverse_volume_of_factor(factor: np.ndarray) -> np.ndarray:
    """The same of covariances whose Cholesky factors (..., n, n) are known."""
    # The determinant itself could overflow.
    diagonal = factor.diagonal(axis1=-2, axis2=-1)
    return np.exp(-2.0 / factor.shape[-1] * np.add.reduce(np.log(diagonal), axis=-1))


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


def alone(base_weights: np.ndarray, ages: np.ndarray) -> np.ndarray:
    """Give all weight to the node itself, whatever it has heard."""
    return np.where(np.arange(ages.shape[-1]) == 0, 1.0, 0.0 * base_weights)


def _where_heard(base_weights: np.ndarray, ages: np.ndarray) -> np.ndarray:
    return np.where(ages < 0, 0.0, base_weights)


def _left_to_self(worth: np.ndarray) -> np.ndarray:
    """Give all weight to entry 0 in lanes where no weight is left."""
    alone = np.eye(worth.shape[-1])[0]
    return np.where((worth > 0).any(axis=-1, keepdims=True), worth, alone)


def _normalise(worth: np.ndarray) -> np.ndarray:
    worth = _left_to_self(worth)
    return worth / worth.sum(axis=-1, keepdims=True)


def keep_own(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """The node's own belief, the first of mean (..., J, n) and cov (..., J, n, n), bit for bit.

    Promises: consistent whenever the node's filter is, for nothing correlated is ever fused.

    Fails: a node that does not observe the plant by itself drifts with it; on an unstable plant
    without bound.

    Args:
        beliefs: of the node and its neighbours.
        weights: not used; the rules that fuse take them.
    """
    return Gaussian(beliefs.mean[..., 0, :], beliefs.cov[..., 0, :, :])
