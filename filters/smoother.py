"""Rauch-Tung-Striebel smoothers: functions over histories of filtered beliefs.

With the filtered belief (x, P) of a step, sigma points X_s of weights w_s of it, and the model's
values Y_s = f(X_s):

    predict   x- = sum w_s Y_s,  P- = sum w_s (Y_s - x-) (Y_s - x-)' + Q
    gain      G = C P-^-1,  C = sum w_s (X_s - x) (Y_s - x-)'
    smooth    x + G (xs - x-),  P + G (Ps - P-) G'

where (xs, Ps) is the smoothed belief of the step after. On linear models the points give the exact
moments: the Rauch-Tung-Striebel smoother (1965). `backward_affine` takes the moments of an affine
model instead of points, for the extended filter and where a covariance is singular:

    predict   x- = f(x),  P- = F P F' + Q,      C = P F'

Histories have steps on the first axis; all axes between it and the last are lanes, and free. A lane
that fails is NaN, and fails alone.

Source: Särkkä (2008), Unscented Rauch-Tung-Striebel smoother, IEEE Trans. Automatic Control 53(3),
section III, the form for additive noise.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.filters.filter import Affine
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import multiply, solve_spd, symmetrise
from concord.filters.moments import Model, sum_of_products
from concord.filters.sigma_points import SigmaPointRule
from concord.filters.ukf import propagated


class Backward(NamedTuple):
    """The way from a step back to the one before it.

    predicted: the belief (..., n) before a step's readings. gain: (..., n, n), what a change of
    the step's state says of the state before it.
    """

    predicted: Gaussian
    gain: np.ndarray


def backward(
    belief: Gaussian, transition: Model, noise_cov: np.ndarray, rule: SigmaPointRule
) -> Backward:
    """The way back to a filtered belief (..., n); arguments as in `concord.filters.ukf.predict`.

    Raises:
        ValueError: the rule, the noise or the model's values do not fit the state.
    """
    points, weighted, predicted = propagated(belief, transition, noise_cov, rule)
    cross_cov = sum_of_products(points - belief.mean, weighted)
    return Backward(predicted, solve_spd(predicted.cov, cross_cov.mT).mT)


def backward_affine(belief: Gaussian, transition: Affine, noise_cov: np.ndarray) -> Backward:
    """The way back to a filtered belief (..., n) through a transition that is affine about it.

    The covariance of the belief may be singular; the way is NaN in a lane whose predicted
    covariance is. Source: Rauch, Tung and Striebel (1965), Maximum likelihood estimates of linear
    dynamic systems, AIAA Journal 3(8).
    """
    ahead_cov = transition.slope @ belief.cov
    cov = symmetrise(ahead_cov @ transition.slope.mT + transition.error_cov) + noise_cov
    predicted = Gaussian(transition.predicted, cov)
    return Backward(predicted, solve_spd(predicted.cov, ahead_cov).mT)


def smoothed(belief: Gaussian, back: Backward, following: Gaussian) -> Gaussian:
    """The filtered belief (..., n) given the smoothed one of the step after it."""
    (mean, cov), gain = back.predicted, back.gain
    return Gaussian(
        belief.mean + multiply(gain, following.mean - mean),
        symmetrise(belief.cov + gain @ (following.cov - cov) @ gain.mT),
    )


def smooth(history: Gaussian, ways: Sequence[Backward]) -> Gaussian:
    """The beliefs (K, ..., n) of K steps given the readings of all of them.

    Args:
        history: filtered beliefs (K, ..., n).
        ways: K - 1 ways back; entry k leads from step k + 1 to step k.
    """
    mean, cov = (values.copy() for values in history)
    for step in reversed(range(len(ways))):
        belief, following = (Gaussian(mean[k], cov[k]) for k in (step, step + 1))
        mean[step], cov[step] = smoothed(belief, ways[step], following)
    return Gaussian(mean, cov)


def smooth_with_lags(history: Gaussian, ways: Sequence[Backward], most: int) -> Gaussian:
    """Fixed-lag estimates (most + 1, K, ..., n) of beliefs (K, ..., n).

    Entry (l, k) is the state of step k - l given the readings up to step k; NaN for k < l.
    Arguments as in `smooth`.
    """
    mean, cov = (np.full((most + 1, *values.shape), np.nan) for values in history)
    mean[0], cov[0] = history
    last = min(most, len(ways))
    if last == 0:
        return Gaussian(mean, cov)
    together = Backward(
        Gaussian(
            *(np.stack(parts) for parts in zip(*(way.predicted for way in ways), strict=True))
        ),
        np.stack([way.gain for way in ways]),
    )
    for lag in range(1, last + 1):
        count = len(history.mean) - lag
        belief, predicted = (
            Gaussian(one.mean[:count], one.cov[:count]) for one in (history, together.predicted)
        )
        following = Gaussian(mean[lag - 1, lag:], cov[lag - 1, lag:])
        back = Backward(predicted, together.gain[:count])
        mean[lag, lag:], cov[lag, lag:] = smoothed(belief, back, following)
    return Gaussian(mean, cov)
