"""Filters with one mistake each, for the tests of `concord check`."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.filters.update import Update


class Right:
    """The unscented filter."""

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray) -> Gaussian:
        return _unscented(belief).predict(belief, transition, noise_cov)

    def update(self, belief: Gaussian, *arguments: Any, **options: Any) -> Update:
        return _unscented(belief).update(belief, *arguments, **options)


def _unscented(belief: Gaussian) -> SigmaPointFilter:
    return SigmaPointFilter(scaled_unscented(belief.mean.shape[-1]))


class Ungated(Right):
    """Takes every reading."""

    def update(self, belief: Gaussian, *arguments: Any, **options: Any) -> Update:
        return super().update(belief, *arguments, **{**options, "gate": None})


class Overconfident(Right):
    """Returns half the covariance."""

    def update(self, belief: Gaussian, *arguments: Any, **options: Any) -> Update:
        found = super().update(belief, *arguments, **options)
        measurement = arguments[0]
        taken = ~np.isnan(measurement).all(-1)[..., None, None]
        kept = (found.belief.mean == belief.mean).all(-1)[..., None, None]
        cov = np.where(taken & ~kept, 0.5 * found.belief.cov, found.belief.cov)
        return found._replace(belief=Gaussian(found.belief.mean, cov))


class Mixed(Right):
    """Adds the mean of the noise of all lanes."""

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray) -> Gaussian:
        moved = super().predict(belief, transition, noise_cov)
        size = np.nanmean(np.diagonal(moved.cov, axis1=-2, axis2=-1))
        return Gaussian(moved.mean, moved.cov + 0.01 * size * np.eye(moved.mean.shape[-1]))


class Absolute(Right):
    """Never believes in a variance below 0.01, whatever the unit."""

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray) -> Gaussian:
        moved = super().predict(belief, transition, noise_cov)
        return Gaussian(moved.mean, moved.cov + 0.01 * np.eye(moved.mean.shape[-1]))


class ZeroForMissing(Right):
    """Takes a missing entry for a reading of 0."""

    def update(self, belief: Gaussian, *arguments: Any, **options: Any) -> Update:
        measurement, *others = arguments
        return super().update(belief, np.nan_to_num(measurement), *others, **options)


@dataclass
class Remembering(Right):
    """Trusts its predictions less with each call."""

    calls: list[int] = field(default_factory=lambda: [0])

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray) -> Gaussian:
        self.calls[0] += 1
        moved = super().predict(belief, transition, noise_cov)
        return Gaussian(moved.mean, moved.cov * (1 + 1e-3 * self.calls[0]))


class Skewed(Right):
    """Returns a covariance that is not symmetric."""

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray) -> Gaussian:
        moved = super().predict(belief, transition, noise_cov)
        tilt = 1e-3 * np.triu(np.abs(moved.cov), 1)
        return Gaussian(moved.mean, moved.cov + tilt)


right, ungated, overconfident, mixed = Right(), Ungated(), Overconfident(), Mixed()
absolute, zero_for_missing, remembering, skewed = (
    Absolute(), ZeroForMissing(), Remembering(), Skewed(),
)  # fmt: skip
