"""A rule of the user's own is tried on beliefs like those of the run before anything starts."""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky
from concord.scenarios.user.faults import fault_sentence

# Axes before that of the neighbours: one node, runs, and more than any driver has.
_TRIED = ((), (3,), (2, 1, 3))
# Of a variance, and of a deviation: an average of a few beliefs loses less.
_ROUNDING = 1e-6

UserRule = Callable[[Gaussian, np.ndarray], Any]


def try_rule(name: str, rule: UserRule, prior: Gaussian, beliefs: int) -> None:
    """Call a rule on so many beliefs near the prior (n,), of one lane and of several.

    Raises:
        ValueError: naming what the rule raises, or what is wrong with its result, and the cure.
    """
    try:
        inspect.signature(rule).bind(None, None)
    except TypeError as error:
        raise ValueError(
            f"rule {name}: it must take two arguments, rule(beliefs, weights): {error}"
        ) from None
    except ValueError:
        pass  # A compiled function may tell no signature.
    for lanes in _TRIED:
        given, weights = _drawn(prior, lanes, beliefs)
        with np.errstate(all="ignore"):
            found = _called(name, rule, given, weights)
            if lanes:
                lane = (0,) * len(lanes)
                alone = _called(name, rule, _at(given, lane), weights[lane])
                _require_own_lanes(name, alone, _at(found, lane))


def _drawn(prior: Gaussian, lanes: tuple[int, ...], beliefs: int) -> tuple[Gaussian, np.ndarray]:
    """Beliefs (*lanes, J, n) whose deviations differ by up to a half, and their weights."""
    shape = (*lanes, beliefs, len(prior.mean))
    place = np.arange(1, 1 + np.prod(shape, dtype=int)).reshape(shape)
    scale = 1 + 0.5 * np.sin(place) ** 2
    mean = prior.mean + 0.5 * np.cos(place) * np.sqrt(np.diagonal(prior.cov))
    weights = 1 + np.arange(beliefs)[::-1] + np.zeros((*lanes, 1))
    return (
        Gaussian(mean, scale[..., None] * prior.cov * scale[..., None, :]),
        weights / weights.sum(axis=-1, keepdims=True),
    )


def _at(beliefs: Gaussian, lane: tuple[int, ...]) -> Gaussian:
    return Gaussian(beliefs.mean[lane], beliefs.cov[lane])


def _called(name: str, rule: UserRule, given: Gaussian, weights: np.ndarray) -> Gaussian:
    """The result of a rule, which is a belief.

    Raises:
        ValueError: it is none.
    """
    *lanes, _, n = given.mean.shape
    called = f"rule {name} with means of shape {given.mean.shape}"
    try:
        result = rule(Gaussian(given.mean.copy(), given.cov.copy()), weights.copy())
    # Code of the user may fail in any way.
    except Exception as error:
        raise ValueError(
            f"{called} fails: {fault_sentence(error)}; correct that function"
        ) from error
    if not isinstance(result, tuple) or len(result) != 2:
        raise ValueError(
            f"{called} returns a {type(result).__name__}: must be Gaussian(mean, cov) of "
            "concord.filters.gaussian"
        )
    mean, cov = map(np.asarray, result)
    if mean.shape == given.mean.shape:
        raise ValueError(
            f"{called} returns the beliefs unfused: must be one belief, of mean {(*lanes, n)} and "
            f"covariance {(*lanes, n, n)}; average over the axis of the neighbours, which is -2 "
            "for means and -3 for covariances"
        )
    if (mean.shape, cov.shape) != ((*lanes, n), (*lanes, n, n)):
        raise ValueError(
            f"{called} returns a mean {mean.shape} and a covariance {cov.shape}: must be "
            f"{(*lanes, n)} and {(*lanes, n, n)}; leading axes are free"
        )
    if mean.dtype.kind not in "fiu" or cov.dtype.kind not in "fiu":
        raise ValueError(
            f"{called} returns a mean of {mean.dtype} and a covariance of {cov.dtype}: must be "
            "real numbers, float64"
        )
    mean, cov = mean.astype(float), cov.astype(float)
    _require_belief(called, mean, cov)
    return Gaussian(mean, cov)


def _require_belief(called: str, mean: np.ndarray, cov: np.ndarray) -> None:
    for what, values in (("mean", mean), ("covariance", cov)):
        if not np.isfinite(values).all():
            raise ValueError(
                f"{called} returns a {what} with {values[~np.isfinite(values)][0]} for beliefs "
                "that are finite; find where the function divides by 0 or takes a root"
            )
    skew = np.abs(cov - cov.mT).max()
    if skew > _ROUNDING * np.abs(cov).max():
        raise ValueError(
            f"{called} returns a covariance that is not symmetric, by {skew:.3g}; return "
            "0.5 * (cov + cov.mT) if the difference is rounding, else correct the formula"
        )
    if np.isnan(cholesky(cov)).any():
        raise ValueError(
            f"{called} returns a covariance that is not positive definite, with an eigenvalue of "
            f"{np.linalg.eigvalsh(cov).min():.3g}; every belief that it got has one"
        )


def _require_own_lanes(name: str, alone: Gaussian, together: Gaussian) -> None:
    deviation = np.sqrt(np.diagonal(alone.cov))
    apart = np.abs(alone.mean - together.mean) / deviation
    spread = np.abs(alone.cov - together.cov) / (deviation[:, None] * deviation)
    if max(apart.max(), spread.max()) > _ROUNDING:
        raise ValueError(
            f"rule {name} of one lane differs from that of several at once: it mixes the lanes; "
            "leading axes are free, so sum over axis -2 of means and -1 of weights"
        )
