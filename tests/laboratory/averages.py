"""Promises of hold policies and of trimmed averages, worked out number by number."""

from collections.abc import Sequence

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.holds import Dropped, Fading, InStep, Renormalised
from concord.scenarios.types.rules import hold_of

_ROUNDING = 1e-6


def broken_promise(
    beliefs: Gaussian, weights: np.ndarray, fused: Gaussian, liars: Sequence[int], expected: int
) -> str:
    """Return how an average breaks the guarantee; "" if it holds, or if too many nodes lie.

    The beliefs are (J, n) with weights (J,), the node's own first; those of `liars` are arbitrary.
    Let c be the median of all means and r the distance of the farthest honest mean from c. Let l be
    the least ratio, in any direction, of an honest covariance to the own covariance. Both r and l
    are taken in the frame in which the own covariance is 1. Then the fused covariance is at least l
    times the own, and (x - c)' P^-1 (x - c) <= r^2 / l.
    """
    used = [j for j, weight in enumerate(weights) if weight > 0 or j == 0]
    honest = [j for j in used if j not in liars]
    if len(used) - len(honest) > expected:
        return ""
    root = np.linalg.cholesky(beliefs.cov[0])
    centre = np.median(beliefs.mean[used], axis=0)
    radius = max(np.linalg.norm(np.linalg.solve(root, beliefs.mean[j] - centre)) for j in honest)
    least = min(_least(root, beliefs.cov[j]) for j in honest)
    sure = _least(root, fused.cov)
    if sure < least * (1 - _ROUNDING):
        return f"a covariance of {sure:.4g} of the own, at least {least:.4g}"
    off = fused.mean - centre
    square = off @ np.linalg.solve(fused.cov, off)
    if square > radius**2 / least * (1 + _ROUNDING) + _ROUNDING:
        return f"{square:.4g} from the median, at most {radius**2 / least:.4g}"
    return ""


def _least(root: np.ndarray, cov: np.ndarray) -> float:
    """Return the least eigenvalue of a covariance in the frame in which root root' is 1."""
    half = np.linalg.solve(root, cov)
    return float(np.linalg.eigvalsh(np.linalg.solve(root, half.T))[0])


def promised_weights(
    scenario: Scenario,
    base: np.ndarray,
    ages: np.ndarray,
    inverse_volume: np.ndarray,
    cycles_in_step: int,
) -> list[float]:
    """Weights (J,) of a node's own belief and of those that it holds, of these ages in cycles."""
    hold = hold_of(scenario.rule) or Renormalised()

    def worth(weight: float, age: int, sharp: float) -> float:
        if age < 0:
            return 0.0
        match hold:
            case Fading(decay=decay):
                return weight * decay**age * sharp
            case Dropped() | Renormalised():
                return weight if age == 0 else 0.0
            case InStep():
                return weight if age <= cycles_in_step else 0.0
        return weight

    worths = [
        worth(*one)
        for one in zip(*(part.tolist() for part in (base, ages, inverse_volume)), strict=True)
    ]
    if isinstance(hold, Dropped):
        return [worths[0] + sum(base) - sum(worths), *worths[1:]]
    total = sum(worths)
    return [one / total for one in worths] if total else [1.0] + [0.0] * (len(worths) - 1)
