"""Damped Fisher scoring: the parameters with the greatest posterior density.

Parameters are in spreads: standard deviations of a prior whose mean is 0.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.identification.likelihood import Likelihood

ITERATIONS = 40
"""Most steps."""
_ENOUGH, _LONGEST = 0.01, 1.0
"""Least squared length of a step in standard deviations; longest step in spreads."""
_IDLE, _GAIN = 4, 0.1
"""The fit ends where so many steps in turn gain no more than this of the log density: where a delay
lies between two samples, steps to either side follow each other without end."""


class Best(NamedTuple):
    """Spreads (p,) at the greatest density, the likelihood beside them, and whether steps ended."""

    spreads: np.ndarray
    likelihood: Likelihood
    converged: bool


def greatest(
    of: Callable[[np.ndarray], Likelihood], spreads: np.ndarray, samples: np.ndarray
) -> Best:
    """Return the parameters (p,) with the greatest posterior density, by damped scoring.

    A delay is evaluated at whole samples, of the lengths `samples` (p,), which are 0 for all else.
    The result is one step away from what was evaluated last.
    """
    damping, at = 0.0, at_samples(spreads, samples)
    here = of(at)
    best, idle = (at, here), 0
    before = found = None
    for _ in range(ITERATIONS):
        found = at + _step(here, at, damping, samples)
        there_at = at_samples(found, samples)
        same_samples = np.allclose(there_at[samples > 0], at[samples > 0])
        if before is not None and same_samples and _length(found - before, here) < _ENOUGH:
            return Best(found, here, True)
        there = of(there_at)
        gained = _density(best[1], best[0]) - _density(there, there_at)
        idle = 0 if gained > _GAIN else idle + 1
        best = (there_at, there) if gained > 0 else best
        if idle == _IDLE:
            at, here = best
            return Best(at + _step(here, at, 0.0, samples), here, True)
        allowed = _density(here, at) + _length(there_at - found, here)
        if _density(there, there_at) < allowed:
            before, at, here, damping = found, there_at, there, damping / 10
        else:
            damping = max(10 * damping, 0.1)
    return Best(at if found is None else found, here, False)


def _density(here: Likelihood, at: np.ndarray) -> float:
    """The negative logarithm of the posterior density, but for a constant."""
    return here.value + float(at @ at) / 2


def _length(step: np.ndarray, here: Likelihood) -> float:
    """The squared length of a step in standard deviations."""
    return float(step @ precision(here) @ step)


def _step(here: Likelihood, at: np.ndarray, damping: float, samples: np.ndarray) -> np.ndarray:
    """The step from spreads (p,) to the top of the parabola there, not too long."""
    curvature = precision(here)
    gradient = here.gradient + at
    step = -np.linalg.solve(curvature + damping * np.diag(np.diagonal(curvature)), gradient)
    step = np.where(samples > 0, np.clip(step, -samples, samples), step)
    return step * min(1.0, _LONGEST / np.abs(step).max())


def precision(here: Likelihood) -> np.ndarray:
    """The precision of the parameters (p, p), that of the prior included.

    The bend of a delay replaces its information where the likelihood bends upwards; products with
    other parameters shrink until the matrix is positive definite.
    """
    whole = here.information + np.eye(len(here.bends))
    bent = here.bends > 0
    whole[bent, bent] = here.bends[bent] + 1
    apart = whole.copy()
    apart[bent, :] = apart[:, bent] = 0.0
    apart[bent, bent] = whole[bent, bent]
    for share in (0.0, 0.1, 0.3, 0.6):
        mixed = (1 - share) * whole + share * apart
        if np.linalg.eigvalsh(mixed)[0] > 0.5:
            return mixed
    return apart


def at_samples(spreads: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Spreads (p,) with delays at the nearest whole samples."""
    length = np.where(samples > 0, samples, 1.0)
    return np.where(samples > 0, length * np.round(spreads / length), spreads)
