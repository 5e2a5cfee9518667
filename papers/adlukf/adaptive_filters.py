"""The paper's dual layer with noise that is adapted: belief and noise in, belief and noise out."""

import numpy as np

from concord.features.vehicle.adaptive import sage_husa
from concord.features.vehicle.adaptive.sage_husa import NoiseEstimate
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model, moments
from concord.filters.sigma_points import SigmaPointRule, sigma_points
from concord.filters.update import Update
from concord.papers.adlukf import dual_layer
from concord.papers.adlukf import sage_husa_as_printed as sage_husa_literal
from concord.papers.adlukf.sage_husa_as_printed import NoiseEvidence, NoiseStatistics


def dual_layer_step(
    belief: Gaussian,
    noise: NoiseEstimate,
    measurement: np.ndarray,
    transition: Model,
    measure: Model,
    process_noise_cov: np.ndarray,
    rule: SigmaPointRule,
) -> tuple[Update, NoiseEstimate]:
    """The ADLUKF in the form that works: `dual_layer.literal`, then R alone by `sage_husa.adapt`.

    Args and raises as `dual_layer.literal`.
    """
    R = noise.cov
    step = dual_layer.literal(belief, measurement, transition, measure, process_noise_cov, R, rule)
    after = step.update.belief
    left, spread = sage_husa.unexplained(after, measurement, measure, rule, np.subtract)
    return step.update, sage_husa.adapt(noise, left, spread)


def dual_layer_literal_step(
    belief: Gaussian,
    noise: NoiseStatistics,
    measurement: np.ndarray,
    transition: Model,
    measure: Model,
    rule: SigmaPointRule,
    *,
    means: bool = False,
) -> tuple[Update, NoiseStatistics]:
    """The ADLUKF as printed: `dual_layer.literal`, then everything by `sage_husa_literal.adapt`.

    `means` adapts q and r too. Args and raises as `dual_layer.literal`.
    """
    measurement = np.asarray(measurement, dtype=float)
    step = dual_layer.literal(
        belief,
        measurement,
        lambda points: transition(points) + noise.process_mean,
        lambda points: measure(points) + noise.measurement_mean,
        noise.process_variances[..., None] * np.eye(belief.mean.shape[-1]),
        noise.measurement_variances[..., None] * np.eye(measurement.shape[-1]),
        rule,
    )
    moved = transition(sigma_points(belief, rule))  # f(X_i) of (30) and (31)
    predicted, deviations = moments(moved, rule, np.subtract)
    after, innovation = step.update.belief, step.update.innovation
    evidence = NoiseEvidence(
        innovation=innovation,
        correction=after.mean - step.predicted,
        posterior_variances=_variances(after.cov),
        process_residual=after.mean - predicted,
        process_spread=(rule.cov_weights[:, None] * deviations**2).sum(axis=-2),
        measurement_residual=innovation + noise.measurement_mean,
        measurement_spread=_variances(step.measured_cov),
    )
    adapted = sage_husa_literal.adapt(noise, evidence, means=means)
    return step.update, adapted


def _variances(cov: np.ndarray) -> np.ndarray:
    return np.diagonal(cov, axis1=-2, axis2=-1)
