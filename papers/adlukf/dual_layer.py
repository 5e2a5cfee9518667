"""The dual-layer unscented Kalman filter: every sigma point is filtered by a UKF of its own.

One call is a whole step, prediction and update, because the method uses the measurement twice. The
inner filters move the outer points with it, then the outer filter conditions on it again. `literal`
does exactly that and is overconfident. `consistent` halves the weight of the reading in each layer.
Its result is the UKF's belief: the second layer adds gain but no information.

Source: Wang, Liu and Cui, Vehicle state estimation based on an adaptive dual-layer unscented Kalman
filter, section 3.2. Its equations, lost in print, are in docs/papers/adlukf.md; the numbers
beside the lines are those of that page.
"""

from typing import NamedTuple

import numpy as np

from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import symmetrise
from concord.filters.moments import Model, check_noise, evaluate, moments
from concord.filters.sigma_points import SigmaPointRule, sigma_points
from concord.filters.update import Update, condition


class DualLayerStep(NamedTuple):
    """Result of one step.

    Attributes:
        update: belief and innovation of the outer filter.
        predicted: mean (..., n) of the outer points, before the outer gain.
        measured_cov: (..., m, m), covariance of the outer points' measurements, without noise.
    """

    update: Update
    predicted: np.ndarray
    measured_cov: np.ndarray


def literal(
    belief: Gaussian,
    measurement: np.ndarray,
    transition: Model,
    measure: Model,
    process_noise_cov: np.ndarray,
    measurement_noise_cov: np.ndarray,
    rule: SigmaPointRule,
) -> DualLayerStep:
    """The belief one step later and given a measurement, as the paper has it: (6)-(27).

    The means q and r of the noises, which the paper adds in (10), (13) and (22), belong to what the
    caller passes as `transition` and `measure`.

    Fails: overconfident, for the reading is used twice.

    Args:
        belief: mean (..., n), cov (..., n, n).
        measurement: (..., m); an entry that is NaN was not taken.
        transition: points (S, ..., n) -> points (S, ..., n).
        measure: points (S, ..., n) -> predicted measurements (S, ..., m).
        process_noise_cov: Q, (n, n) or (..., n, n).
        measurement_noise_cov: R, (m, m) or (..., m, m).
        rule: a sigma-point rule for n dimensions, used in both layers.

    Returns:
        A DualLayerStep; NaN in a lane that has lost positive definiteness.

    Raises:
        ValueError: the rule, a noise, the measurement or a model's values do not fit.
    """
    measurement = np.asarray(measurement, dtype=float)
    m, Q, R = measurement.shape[-1], process_noise_cov, measurement_noise_cov
    check_noise(R, m, "measurement noise covariance")
    # (17) gives the outer points; an inner filter's own covariance, (18), the paper never uses.
    points = _inner(belief, measurement, transition, measure, Q, R, rule).mean
    mean, deviations = moments(points, rule, np.subtract)  # (19)
    weighted = (rule.cov_weights[:, None] * deviations).mT
    cov = symmetrise(weighted @ deviations + Q)  # (20)
    values = evaluate(measure, points, m, "measure")  # (21)
    predicted, spread = moments(values, rule, np.subtract)  # (22)
    measured_cov = symmetrise((rule.cov_weights[:, None] * spread).mT @ spread)  # (23) without R
    outer = Gaussian(mean, cov)
    update = condition(
        outer, measurement, predicted, measured_cov + R, weighted @ spread, np.subtract
    )  # (24)-(27)
    return DualLayerStep(update, mean, measured_cov)


def consistent(
    belief: Gaussian,
    measurement: np.ndarray,
    transition: Model,
    measure: Model,
    process_noise_cov: np.ndarray,
    measurement_noise_cov: np.ndarray,
    rule: SigmaPointRule,
) -> DualLayerStep:
    """The same without counting the reading twice: each layer takes it with noise 2 R.

    The outer points share the inner filters' covariance, so theirs is its average, and they are
    redrawn for the outer update. Equal to the UKF on linear models.

    Args, returns and raises as `literal`.
    """
    measurement = np.asarray(measurement, dtype=float)
    Q, R = process_noise_cov, 2.0 * measurement_noise_cov
    check_noise(R, measurement.shape[-1], "measurement noise covariance")
    inner = _inner(belief, measurement, transition, measure, Q, R, rule)
    mean, _ = moments(inner.mean, rule, np.subtract)
    cov = symmetrise(np.tensordot(rule.mean_weights, inner.cov, axes=1))
    outer = Gaussian(mean, cov)
    update = ukf.update(outer, measurement, measure, R, rule)
    return DualLayerStep(update, mean, update.innovation_cov - R)


def _inner(
    belief: Gaussian,
    measurement: np.ndarray,
    transition: Model,
    measure: Model,
    process_noise_cov: np.ndarray,
    measurement_noise_cov: np.ndarray,
    rule: SigmaPointRule,
) -> Gaussian:
    """The beliefs (S, ..., n) of the inner filters, one for each outer point: (8)-(18)."""
    points = sigma_points(belief, rule)
    each = Gaussian(points, np.broadcast_to(belief.cov, (*points.shape, points.shape[-1])))
    each = ukf.predict(each, transition, process_noise_cov, rule)
    return ukf.update(each, measurement, measure, measurement_noise_cov, rule).belief
