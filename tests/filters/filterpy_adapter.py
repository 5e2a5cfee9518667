"""The names of `filterpy.kalman` that its unscented tests use, over our functions.

A result that is not finite ends the test, as filterpy's own tests say little of results.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.linalg import helmert

from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.moments import sum_of_products, weigh, weighted_mean
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented, sigma_points
from concord.filters.smoother import backward, smooth


class MerweScaledSigmaPoints:
    """`scaled_unscented` with filterpy's arguments."""

    def __init__(self, n: int, alpha: float, beta: float, kappa: float) -> None:
        self.n, self.rule = n, scaled_unscented(n, alpha, beta, kappa)
        self.Wm, self.Wc = self.rule.mean_weights, self.rule.cov_weights

    def sigma_points(self, x: Any, P: Any) -> np.ndarray:
        mean = np.asarray(x, dtype=float).reshape(self.n)
        cov = np.asarray(P, dtype=float).reshape(self.n, self.n)
        return finite(sigma_points(Gaussian(mean, cov), self.rule))


class JulierSigmaPoints(MerweScaledSigmaPoints):
    """Unscaled points: alpha 1, beta 0."""

    def __init__(self, n: int, kappa: float) -> None:
        super().__init__(n, 1.0, 0.0, kappa)


class SimplexSigmaPoints(MerweScaledSigmaPoints):
    """The n + 1 corners of a regular simplex as a rule that a user brings: equal weights."""

    def __init__(self, n: int) -> None:
        self.n, self.Wm = n, np.full(n + 1, 1 / (n + 1))
        self.Wc = self.Wm
        self.rule = SigmaPointRule(np.sqrt(n + 1) * helmert(n + 1).T, self.Wm, self.Wc)


def finite(values: np.ndarray) -> np.ndarray:
    assert np.isfinite(values).all()
    return values


def unscented_transform(
    sigmas: np.ndarray, Wm: np.ndarray, Wc: np.ndarray, noise_cov: Any = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n,) and covariance (n, n) of points (S, n)."""
    rule = SigmaPointRule(np.zeros_like(sigmas), Wm, Wc)
    mean = weighted_mean(sigmas, rule, np.subtract)
    away = sigmas - mean
    return mean, sum_of_products(weigh(away, rule), away) + noise_cov


class UnscentedKalmanFilter:
    """`ukf.predict`, `ukf.update` and `smoother.smooth` as one object."""

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dt: float,
        hx: Callable[[np.ndarray], Any],
        fx: Callable[[np.ndarray, float], Any],
        points: MerweScaledSigmaPoints,
    ) -> None:
        self.x, self.P, self.Q = np.zeros(dim_x), np.eye(dim_x), np.eye(dim_x)
        self.R: Any = np.eye(dim_z)
        self.x_prior, self.P_prior = self.x, self.P
        self.y, self.SI = np.zeros(dim_z), np.eye(dim_z)
        self.K, self.mahalanobis = np.zeros((dim_x, dim_z)), 0.0
        self._sizes, self._rule, self._dt = (dim_x, dim_z), points.rule, dt
        self._fx, self._hx = fx, hx

    def _transition(self, points: np.ndarray) -> np.ndarray:
        return self._at_each(lambda x: self._fx(x, self._dt), points, self._sizes[0])

    def _measure(self, points: np.ndarray) -> np.ndarray:
        return self._at_each(self._hx, points, self._sizes[1])

    @staticmethod
    def _at_each(function: Callable[[np.ndarray], Any], points: np.ndarray, size: int):
        rows = points.reshape(-1, points.shape[-1])
        values = np.array([np.atleast_1d(function(row)) for row in rows])
        return values.reshape(*points.shape[:-1], size)

    def _keep(self, belief: Gaussian) -> None:
        self.x, self.P = finite(belief.mean), finite(belief.cov)

    def predict(self) -> None:
        belief = Gaussian(self.x, self.P)
        self._keep(ukf.predict(belief, self._transition, self.Q, self._rule))
        self.x_prior, self.P_prior = self.x, self.P

    def update(self, z: Any) -> None:
        """Without a measurement (None) nothing changes."""
        size = self._sizes[1]
        measurement = np.full(size, np.nan) if z is None else np.atleast_1d(z).astype(float)
        noise_cov = self.R if np.ndim(self.R) else np.asarray(self.R) * np.eye(size)
        belief = Gaussian(self.x, self.P)
        *_, cross_cov = ukf.measured(belief, self._measure, size, self._rule)
        found = ukf.update(belief, measurement, self._measure, noise_cov, self._rule)
        self._keep(found.belief)
        self.y, self.SI = found.innovation, np.linalg.inv(found.innovation_cov)
        self.K = cross_cov @ self.SI
        self.mahalanobis = float(np.sqrt(found.normalised_innovation_squared))

    def batch_filter(self, zs: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
        means, covs = [], []
        for z in zs:
            self.predict()
            self.update(z)
            means.append(self.x)
            covs.append(self.P)
        return np.array(means), np.array(covs)

    def rts_smoother(
        self, Xs: np.ndarray, Ps: np.ndarray, Qs: Any = None, dts: float | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Means, covariances and gains."""
        assert dts in (None, self._dt)
        noises = [self.Q] * len(Xs) if Qs is None else Qs
        ways = [
            backward(Gaussian(mean, cov), self._transition, noise_cov, self._rule)
            for mean, cov, noise_cov in zip(Xs[:-1], Ps[:-1], noises, strict=False)
        ]
        found = smooth(Gaussian(Xs, Ps), ways)
        return finite(found.mean), finite(found.cov), np.array([way.gain for way in ways])
