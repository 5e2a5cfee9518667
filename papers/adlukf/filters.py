"""The filters that the ADLUKF study compares: belief and memory in, update and memory out."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from concord.features.vehicle.adaptive import correntropy, sage_husa
from concord.features.vehicle.adaptive.adaptive_filter import AdaptiveFilter
from concord.features.vehicle.adaptive.fuzzy_noise import FuzzyMatching
from concord.features.vehicle.adaptive.noise_law import NoiseLaw
from concord.features.vehicle.adaptive.sage_husa import NoiseEstimate, SageHusa
from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model, moments
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import SigmaPointRule, cubature, scaled_unscented, sigma_points
from concord.filters.update import Update
from concord.papers.adlukf import dual_layer
from concord.papers.adlukf import sage_husa_as_printed as sage_husa_literal
from concord.papers.adlukf.sage_husa_as_printed import NoiseEvidence, NoiseStatistics

Memory = Any

UNSCENTED = scaled_unscented(3, alpha=0.1, beta=2.0, kappa=0.0)
"""The paper's rule: kappa is 0 from three states on; alpha and beta are chosen here."""
BANDWIDTH = 3.0
"""Of the maximum-correntropy filter, in standard deviations."""


class StepInput(NamedTuple):
    """Input of a filter in one step: models, reading (..., 3) and process noise (..., 3, 3)."""

    transition: Model
    measure: Model
    measurement: np.ndarray
    process_noise_cov: np.ndarray


class Contestant(NamedTuple):
    """A filter: `begin(Q (..., 3, 3), R0 (..., 3))` makes its memory, `step` takes one reading."""

    name: str
    what: str
    begin: Callable[[np.ndarray, np.ndarray], Memory]
    step: Callable[[Gaussian, Memory, StepInput], tuple[Update, Memory]]


# --- filters that are given R --------------------------------------------------------------------


def _given(
    name: str, what: str, update: Callable[[Gaussian, np.ndarray, StepInput], Update]
) -> Contestant:
    """A filter whose memory is R, by one whole step of it."""

    return Contestant(name, what, _noise_cov, lambda belief, R, task: (update(belief, R, task), R))


def _noise_cov(_: np.ndarray, variances: np.ndarray) -> np.ndarray:
    return variances[..., None] * np.eye(variances.shape[-1])


def _kalman(rule: SigmaPointRule, belief: Gaussian, R: np.ndarray, task: StepInput) -> Update:
    moved = ukf.predict(belief, task.transition, task.process_noise_cov, rule)
    return ukf.update(moved, task.measurement, task.measure, R, rule)


def _robust(belief: Gaussian, R: np.ndarray, task: StepInput) -> Update:
    moved = ukf.predict(belief, task.transition, task.process_noise_cov, UNSCENTED)
    return correntropy.update(moved, task.measurement, task.measure, R, UNSCENTED, BANDWIDTH)


def _dual(
    form: Callable[..., dual_layer.DualLayerStep], belief: Gaussian, R: np.ndarray, task: StepInput
) -> Update:
    f, h, z, Q = task
    return form(belief, z, f, h, Q, R, UNSCENTED).update


# --- filters that learn the noise ----------------------------------------------------------------

LAWS: dict[str, NoiseLaw[Any]] = {
    "AUKF": SageHusa(),
    "AUKF limited": SageHusa(outlier_limit=9.0),
    "FAUKF": FuzzyMatching(),
}
"""How filters on the plain UKF learn R, with factors of the variances R0 that they start with."""


def _on_ukf(name: str, what: str) -> Contestant:
    """A UKF that learns R by a law; its memory is R0 and what the law keeps."""
    own = AdaptiveFilter(SigmaPointFilter(UNSCENTED), LAWS[name], UNSCENTED)

    def begin(process_noise_cov: np.ndarray, variances: np.ndarray) -> Memory:
        return _noise_cov(process_noise_cov, variances), own.begin(variances.shape)

    def step(belief: Gaussian, memory: Memory, task: StepInput) -> tuple[Update, Memory]:
        noise_cov, learnt = memory
        moved = own.predict(belief, task.transition, task.process_noise_cov)
        taken, learnt = own.update_and_learn(
            moved, learnt, task.measurement, task.measure, noise_cov
        )
        return taken, (noise_cov, learnt)

    return Contestant(name, what, begin, step)


def dual_layer_step(
    belief: Gaussian, noise: NoiseEstimate, task: StepInput
) -> tuple[Update, NoiseEstimate]:
    """The ADLUKF in the form that works: `dual_layer.literal`, then R alone by `sage_husa.adapt`.

    Raises as `dual_layer.literal`.
    """
    f, h, z, Q = task
    update = dual_layer.literal(belief, z, f, h, Q, noise.cov, UNSCENTED).update
    left, spread = sage_husa.unexplained(update.belief, z, h, UNSCENTED, np.subtract)
    return update, sage_husa.adapt(noise, left, spread)


def dual_layer_literal_step(
    belief: Gaussian, noise: NoiseStatistics, task: StepInput, *, means: bool = False
) -> tuple[Update, NoiseStatistics]:
    """The ADLUKF as printed: `dual_layer.literal`, then everything by `sage_husa_literal.adapt`.

    `means` adapts q and r too. Raises as `dual_layer.literal`.
    """
    transition, measure, measurement, _ = task
    step = dual_layer.literal(
        belief,
        measurement,
        lambda points: transition(points) + noise.process_mean,
        lambda points: measure(points) + noise.measurement_mean,
        noise.process_variances[..., None] * np.eye(belief.mean.shape[-1]),
        noise.measurement_variances[..., None] * np.eye(measurement.shape[-1]),
        UNSCENTED,
    )
    moved = transition(sigma_points(belief, UNSCENTED))  # f(X_i) of (30) and (31)
    predicted, deviations = moments(moved, UNSCENTED, np.subtract)
    after, innovation = step.update.belief, step.update.innovation
    evidence = NoiseEvidence(
        innovation=innovation,
        correction=after.mean - step.predicted,
        posterior_variances=_variances(after.cov),
        process_residual=after.mean - predicted,
        process_spread=(UNSCENTED.cov_weights[:, None] * deviations**2).sum(axis=-2),
        measurement_residual=innovation + noise.measurement_mean,
        measurement_spread=_variances(step.measured_cov),
    )
    return step.update, sage_husa_literal.adapt(noise, evidence, means=means)


def _variances(cov: np.ndarray) -> np.ndarray:
    return np.diagonal(cov, axis1=-2, axis2=-1)


def _statistics(process_noise_cov: np.ndarray, variances: np.ndarray) -> Memory:
    return sage_husa_literal.begin(_variances(process_noise_cov), variances)


CONTESTANTS = {
    one.name: one
    for one in (
        _given("CKF", "cubature Kalman filter", partial(_kalman, cubature(3))),
        _given("UKF", "unscented Kalman filter", partial(_kalman, UNSCENTED)),
        _on_ukf("FAUKF", "UKF, R by fuzzy covariance matching"),
        Contestant(
            "ADLUKF", "dual layer, R alone by Sage-Husa in residual form",
            lambda _, variances: sage_husa.begin(variances), dual_layer_step,
        ),
        Contestant(
            "ADLUKF printed",
            "the paper's: dual layer, Q and R by Sage-Husa, absolute values, bounds",
            _statistics, dual_layer_literal_step,
        ),
        Contestant(
            "ADLUKF printed, q r", "the same with the means q and r",
            _statistics, partial(dual_layer_literal_step, means=True),
        ),
        _given("DLUKF", "dual layer without adaptation", partial(_dual, dual_layer.literal)),
        _given(
            "DLUKF consistent", "dual layer that counts a reading once",
            partial(_dual, dual_layer.consistent),
        ),
        _on_ukf("AUKF", "ADLUKF's adaptation on a plain UKF"),
        _on_ukf("AUKF limited", "AUKF, a reading counts as 3 sigma at most"),
        _given("MCUKF", "maximum-correntropy UKF", _robust),
    )
}  # fmt: skip
