"""The square-root form of a sigma-point filter: factors of covariances, and no difference of them.

`conditioning` subtracts covariances, and loses as many digits as the variance of a predicted
reading has more than the noise R: a ratio of 1e13 leaves three. Here the deviations of the points
and a factor of R form one array, whose triangular factor holds those of the innovation covariance
and of the posterior covariance. Nothing is subtracted:

    [ sqrt(w) (Y - y)   sqrt(R) ]         [ F  0 ]
    [ sqrt(w) (X - x)      0    ] Theta = [ G  L ],    S = F F', K = G F^-1, P+ = L L'

The prediction is the first line alone, with Q in place of R. Q may be singular.

Source: Kailath, Sayed and Hassibi (2000), Linear estimation, section 12.3; Arasaratnam and Haykin
(2009), Cubature Kalman filters, appendix.
"""

from dataclasses import dataclass

import numpy as np

from concord.filters import square_root
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, inverse_of_triangle, multiply
from concord.filters.moments import (
    Model,
    Residual,
    check_noise,
    evaluate,
    moments,
    points_last,
)
from concord.filters.sigma_points import SigmaPointRule, sigma_points
from concord.filters.update import Update, missing_entries, settle, without_rows

LARGEST_RATIO = 1e10
"""Of the variance of a predicted reading to that of its noise, for the other form."""


def cancels(cov: np.ndarray, noise_cov: np.ndarray, measurement: np.ndarray) -> np.ndarray | None:
    """Lanes (...) in which the covariance (..., m, m) of a predicted reading is so large beside the
    noise that `conditioning` loses digits; None for no lane. Entries of the measurement (..., m)
    that were not taken do not count."""
    lost = cov.diagonal(0, -2, -1) > LARGEST_RATIO * noise_cov.diagonal(0, -2, -1)
    # An array is seldom searched, and counted in a seventh of the time.
    if not np.count_nonzero(lost):
        return None
    lost = lost & ~np.isnan(measurement)
    return np.asarray(lost.any(axis=-1)) if np.count_nonzero(lost) else None


def predict(
    belief: Gaussian, transition: Model, noise_cov: np.ndarray, rule: SigmaPointRule
) -> Gaussian:
    """The belief one step later; arguments and result as of `ukf.predict`.

    The weights of covariances of the rule must not be negative.
    """
    n = belief.mean.shape[-1]
    check_noise(noise_cov, n, "process noise covariance")
    values = evaluate(transition, sigma_points(belief, rule), n, "transition")
    mean, away = moments(values, rule, np.subtract)
    away = np.sqrt(rule.cov_weights)[:, None] * away
    noise_root = np.broadcast_to(root(noise_cov).mT, (*away.shape[:-2], n, n))
    rows = np.concatenate([away, noise_root], axis=-2)
    L: np.ndarray = np.swapaxes(np.linalg.qr(rows, mode="r"), -1, -2)
    return Gaussian(mean, L @ L.mT)


def root(cov: np.ndarray) -> np.ndarray:
    """A root A (..., n, n), A A' = cov, of a covariance that may be singular; NaN in a lane that is
    not finite."""
    sound = np.asarray(np.isfinite(cov).all(axis=(-1, -2)))[..., None, None]
    values, vectors = np.linalg.eigh(np.where(sound, cov, 0.0))
    return np.where(sound, vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :], np.nan)


def update(
    belief: Gaussian,
    measurement: np.ndarray,
    measure: Model,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual = np.subtract,
    gate: float | None = None,
) -> Update:
    """The belief given a measurement; arguments and result as of `ukf.update`.

    The weights of covariances of the rule must not be negative. A lane is NaN whose noise is
    singular.
    """
    n, m = belief.mean.shape[-1], measurement.shape[-1]
    points = sigma_points(belief, rule)
    predicted, away = moments(evaluate(measure, points, m, "measure"), rule, residual)
    roots = np.sqrt(rule.cov_weights)[:, None]
    spread = roots * points_last(points - belief.mean)
    away = roots * away
    missing = missing_entries(measurement)
    if missing is not None:
        noise_cov = without_rows(noise_cov, missing)
        away = np.where(missing[..., None, :], 0.0, away)
        measurement = np.where(missing, predicted, measurement)
    innovation = residual(measurement, predicted)
    if missing is not None:
        innovation = np.where(missing, 0.0, innovation)
    noise_root = np.broadcast_to(cholesky(noise_cov).mT, (*away.shape[:-2], m, m))
    none = np.zeros((*away.shape[:-2], m, n))
    # Large rows come first, which keeps the small ones exact.
    rows = np.concatenate(
        [np.concatenate([away, spread], axis=-1), np.concatenate([noise_root, none], axis=-1)],
        axis=-2,
    )
    factor: np.ndarray = np.swapaxes(np.linalg.qr(rows, mode="r"), -1, -2)
    F, G, L = factor[..., :m, :m], factor[..., m:, :m], factor[..., m:, m:]
    whitened = multiply(inverse_of_triangle(F), innovation)
    after = Gaussian(belief.mean + multiply(G, whitened), L @ L.mT)
    squared = np.vecdot(whitened, whitened)
    return settle(belief, after, innovation, F @ F.mT, squared, missing, gate)


@dataclass(frozen=True, eq=False)
class SquareRootFilter:
    """`square_root.predict` and `square_root.update` with one rule, as a value.

    The update loses no digits where a reading is far sharper than its prediction. A belief between
    two calls is a covariance, because nodes fuse and share covariances, so the form does not keep
    more digits than a covariance holds.

    Raises:
        ValueError: a weight of the rule for covariances is negative and has no root.
    """

    rule: SigmaPointRule

    def __post_init__(self) -> None:
        if (self.rule.cov_weights < 0).any():
            raise ValueError(
                f"the sigma points for {self.rule.unit_points.shape[1]} states have a negative "
                "weight, which has no square root: use cubature points (--filter srckf)"
            )

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """Return the result of `square_root.predict`."""
        return square_root.predict(belief, transition, noise_cov, self.rule)

    def update(
        self,
        belief: Gaussian,
        measurement: np.ndarray,
        measure: Model,
        noise_cov: np.ndarray,
        /,
        *,
        residual: Residual = np.subtract,
        gate: float | None = None,
    ) -> Update:
        """Return the result of `square_root.update`."""
        measurement = np.asarray(measurement, dtype=float)
        check_noise(noise_cov, measurement.shape[-1], "measurement noise covariance")
        return square_root.update(
            belief, measurement, measure, noise_cov, self.rule, residual, gate
        )
