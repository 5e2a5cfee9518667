"""The maximum-correntropy unscented filter: a reading far off its prediction loses its weight.

The update maximises the correntropy of the whitened errors of state and measurement instead of
minimising their squares: every error e weighs exp(-e^2 / (2 b^2)). It is found by a fixed-point
iteration from the prediction. Outliers are ignored one by one, where adaptation of the noise learns
them as if they were the rule.

Sources: Chen, Liu, Zhao and Principe (2017), Maximum correntropy Kalman filter; Liu, Chen, Xu, Wu
and Honeine (2017), Maximum correntropy unscented filter (the statistical linearisation). Here the
noise of the linearised measurement is R plus the spread that the sigma points leave unexplained. An
infinite bandwidth therefore gives `ukf.update` exactly. The iteration uses precisions, so that a
weight of zero causes no singularity.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, inverse_spd, multiply, symmetrise
from concord.filters.moments import Model, Residual, check_noise, evaluate, moments, points_last
from concord.filters.sigma_points import SigmaPointRule, sigma_points
from concord.filters.update import Update, missing_entries, settle, without_rows


def update(
    belief: Gaussian,
    measurement: np.ndarray,
    measure: Model,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    bandwidth: float,
    *,
    iterations: int = 100,
    tolerance: float = 1e-6,
    residual: Residual = np.subtract,
    gate: float | None = None,
) -> Update:
    """The belief given a measurement, its outliers discounted.

    Fails: a measurement noise that has grown for good looks like many outliers; the filter then
    follows its model. And while the state is far off its prediction, good readings are outliers.

    Args:
        belief: mean (..., n), cov (..., n, n).
        measurement: (..., m); an entry that is NaN was not taken.
        measure: points (S, ..., n) -> predicted measurements (S, ..., m).
        noise_cov: covariance of the additive measurement noise, (m, m) or (..., m, m).
        rule: a sigma-point rule for n dimensions.
        bandwidth: b, in standard deviations of an error; 2 to 5 are usual, infinity gives the UKF.
        iterations: most steps to the fixed point; each shrinks the error by a factor.
        tolerance: a lane stops when a step moves no state by more than this part of its standard
            deviation before the reading.
        residual: difference of two measurements, for measurements with angles.
        gate: lanes whose normalised innovation squared exceeds it keep their belief.

    Returns:
        An Update; NaN in a lane whose state or noise covariance is not positive definite. The
        innovation and its covariance are those of the UKF, with no weight applied.

    Raises:
        ValueError: bandwidth <= 0, or the rule, the noise, the measurement or the model's values
            do not fit.
    """
    if not bandwidth > 0:
        raise ValueError(
            f"bandwidth is {bandwidth}, but is a number of standard deviations: choose 2 to 5"
        )
    measurement = np.asarray(measurement, dtype=float)
    m = measurement.shape[-1]
    check_noise(noise_cov, m, "measurement noise covariance")
    points = sigma_points(belief, rule)
    predicted, deviations = moments(evaluate(measure, points, m, "measure"), rule, residual)
    weighted = rule.cov_weights[:, None] * deviations
    innovation_cov = weighted.mT @ deviations + noise_cov
    cross_cov = points_last(points - belief.mean).mT @ weighted
    missing = missing_entries(measurement)
    if missing is None:
        innovation = residual(measurement, predicted)
    else:
        taken = np.where(missing, predicted, measurement)
        innovation = np.where(missing, 0.0, residual(taken, predicted))
        innovation_cov = without_rows(innovation_cov, missing)
        cross_cov = np.where(missing[..., None, :], 0.0, cross_cov)
    linear = _linearised(belief, innovation_cov, cross_cov)
    gain = _fixed_point(belief, linear, innovation, bandwidth, (iterations, tolerance))
    left = np.eye(gain.shape[-2]) - gain @ linear.rows
    cov = symmetrise(left @ belief.cov @ left.mT + gain @ linear.noise_cov @ gain.mT)
    after = Gaussian(belief.mean + multiply(gain, innovation), cov)
    whitened = multiply(np.linalg.inv(cholesky(innovation_cov)), innovation)
    squared = np.vecdot(whitened, whitened)
    return settle(belief, after, innovation, innovation_cov, squared, missing, gate)


@dataclass(frozen=True, eq=False)
class CorrentropyFilter:
    """The maximum-correntropy filter as a value: the predictions of `ukf`, and `update`."""

    rule: SigmaPointRule
    bandwidth: float
    iterations: int

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """Return the result of `ukf.predict`."""
        return ukf.predict(belief, transition, noise_cov, self.rule)

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
        """The belief given a measurement, its outliers discounted."""
        return update(
            belief,
            measurement,
            measure,
            noise_cov,
            self.rule,
            self.bandwidth,
            iterations=self.iterations,
            residual=residual,
            gate=gate,
        )


class _Linear(NamedTuple):
    """z = rows x + noise about the prediction, and what whitens either."""

    rows: np.ndarray
    noise_cov: np.ndarray
    state_whitener: np.ndarray
    noise_whitener: np.ndarray


def _linearised(belief: Gaussian, innovation_cov: np.ndarray, cross_cov: np.ndarray) -> _Linear:
    rows = cross_cov.mT @ inverse_spd(belief.cov)
    noise_cov = symmetrise(innovation_cov - rows @ cross_cov)
    return _Linear(
        rows,
        noise_cov,
        np.linalg.inv(cholesky(belief.cov)),
        np.linalg.inv(cholesky(noise_cov)),
    )


def _fixed_point(
    belief: Gaussian,
    linear: _Linear,
    innovation: np.ndarray,
    bandwidth: float,
    limits: tuple[int, float],
) -> np.ndarray:
    """Gain (..., n, m) that its own weights give; `limits` are iterations and tolerance."""
    iterations, tolerance = limits
    least = tolerance * np.sqrt(np.abs(np.diagonal(belief.cov, axis1=-2, axis2=-1)))
    gain = np.zeros((*innovation.shape[:-1], *linear.rows.mT.shape[-2:]))
    is_open = np.ones(innovation.shape[:-1], dtype=bool)
    for _ in range(iterations):
        shift = multiply(gain, innovation)
        found = _gain(linear, shift, innovation, bandwidth)
        gain = np.where(is_open[..., None, None], found, gain)
        is_open = is_open & (np.abs(multiply(found, innovation) - shift) > least).any(axis=-1)
        if not is_open.any():
            break
    return gain


def _gain(
    linear: _Linear, shift: np.ndarray, innovation: np.ndarray, bandwidth: float
) -> np.ndarray:
    """Gain (..., n, m) of the weighted least squares with the weights at prediction + shift."""
    state_error = multiply(linear.state_whitener, shift)
    noise_error = multiply(linear.noise_whitener, innovation - multiply(linear.rows, shift))
    state_root = _kernel(state_error, bandwidth)[..., None] * linear.state_whitener
    noise_root = _kernel(noise_error, bandwidth)[..., None] * linear.noise_whitener
    seen = linear.rows.mT @ (noise_root.mT @ noise_root)
    precision = state_root.mT @ state_root + seen @ linear.rows
    return inverse_spd(symmetrise(precision)) @ seen


def _kernel(error: np.ndarray, bandwidth: float) -> np.ndarray:
    """Square root of the weight of a whitened error."""
    return np.exp(-((0.5 * error / bandwidth) ** 2))
