"""The filters that the ADLUKF study compares, all behind one face: belief and memory in and out."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from concord.features.vehicle.adaptive import correntropy, sage_husa
from concord.features.vehicle.adaptive.adaptive_filter import AdaptiveFilter
from concord.features.vehicle.adaptive.fuzzy_noise import FuzzyMatching
from concord.features.vehicle.adaptive.noise_law import NoiseLaw
from concord.features.vehicle.adaptive.sage_husa import SageHusa
from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import SigmaPointRule, cubature, scaled_unscented
from concord.papers.adlukf import adaptive_filters as adaptive
from concord.papers.adlukf import dual_layer
from concord.papers.adlukf import sage_husa_as_printed as sage_husa_literal

Memory = Any

UNSCENTED = scaled_unscented(3, alpha=0.1, beta=2.0, kappa=0.0)
"""The paper's rule: kappa is 0 from three states on; alpha and beta are chosen here."""
CUBATURE = cubature(3)
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
    step: Callable[[Gaussian, Memory, StepInput], tuple[Gaussian, Memory]]


def _fixed(
    rule: SigmaPointRule,
) -> Callable[[Gaussian, Memory, StepInput], tuple[Gaussian, Memory]]:
    """A filter whose memory is R."""

    def step(belief: Gaussian, noise_cov: Memory, task: StepInput) -> tuple[Gaussian, Memory]:
        moved = ukf.predict(belief, task.transition, task.process_noise_cov, rule)
        taken = ukf.update(moved, task.measurement, task.measure, noise_cov, rule)
        return taken.belief, noise_cov

    return step


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

    def step(belief: Gaussian, memory: Memory, task: StepInput) -> tuple[Gaussian, Memory]:
        noise_cov, learnt = memory
        moved = own.predict(belief, task.transition, task.process_noise_cov)
        taken, learnt = own.update_and_learn(
            moved, learnt, task.measurement, task.measure, noise_cov
        )
        return taken.belief, (noise_cov, learnt)

    return Contestant(name, what, begin, step)


def _robust(belief: Gaussian, noise_cov: Memory, task: StepInput) -> tuple[Gaussian, Memory]:
    moved = ukf.predict(belief, task.transition, task.process_noise_cov, UNSCENTED)
    taken = correntropy.update(
        moved, task.measurement, task.measure, noise_cov, UNSCENTED, BANDWIDTH
    )
    return taken.belief, noise_cov


def _dual(form: Any) -> Callable[[Gaussian, Memory, StepInput], tuple[Gaussian, Memory]]:
    """A form of the dual-layer filter whose memory is R."""

    def step(belief: Gaussian, noise_cov: Memory, task: StepInput) -> tuple[Gaussian, Memory]:
        f, h, z, Q = task
        return form(belief, z, f, h, Q, noise_cov, UNSCENTED).update.belief, noise_cov

    return step


def _dual_adaptive(belief: Gaussian, noise: Memory, task: StepInput) -> tuple[Gaussian, Memory]:
    f, h, z, Q = task
    taken, noise = adaptive.dual_layer_step(belief, noise, z, f, h, Q, UNSCENTED)
    return taken.belief, noise


def _dual_printed(means: bool) -> Callable[[Gaussian, Memory, StepInput], tuple[Gaussian, Memory]]:
    """The paper's filter; `means` adapts q and r too."""

    def step(belief: Gaussian, noise: Memory, task: StepInput) -> tuple[Gaussian, Memory]:
        f, h, z, _ = task
        taken, noise = adaptive.dual_layer_literal_step(
            belief, noise, z, f, h, UNSCENTED, means=means
        )
        return taken.belief, noise

    return step


def _noise_cov(_: np.ndarray, variances: np.ndarray) -> np.ndarray:
    return variances[..., None] * np.eye(variances.shape[-1])


def _sage_husa(_: np.ndarray, variances: np.ndarray) -> Memory:
    return sage_husa.begin(variances)


def _statistics(process_noise_cov: np.ndarray, variances: np.ndarray) -> Memory:
    return sage_husa_literal.begin(np.diagonal(process_noise_cov, axis1=-2, axis2=-1), variances)


CONTESTANTS = {
    contestant.name: contestant
    for contestant in (
        Contestant("CKF", "cubature Kalman filter", _noise_cov, _fixed(CUBATURE)),
        Contestant("UKF", "unscented Kalman filter", _noise_cov, _fixed(UNSCENTED)),
        _on_ukf("FAUKF", "UKF, R by fuzzy covariance matching"),
        Contestant(
            "ADLUKF",
            "dual layer, R alone by Sage-Husa in residual form",
            _sage_husa,
            _dual_adaptive,
        ),
        Contestant(
            "ADLUKF printed",
            "the paper's: dual layer, Q and R by Sage-Husa, absolute values, bounds",
            _statistics,
            _dual_printed(means=False),
        ),
        Contestant(
            "ADLUKF printed, q r",
            "the same with the means q and r",
            _statistics,
            _dual_printed(means=True),
        ),
        Contestant("DLUKF", "dual layer without adaptation", _noise_cov, _dual(dual_layer.literal)),
        Contestant(
            "DLUKF consistent",
            "dual layer that counts a reading once",
            _noise_cov,
            _dual(dual_layer.consistent),
        ),
        _on_ukf("AUKF", "ADLUKF's adaptation on a plain UKF"),
        _on_ukf("AUKF limited", "AUKF, a reading counts as 3 sigma at most"),
        Contestant("MCUKF", "maximum-correntropy UKF", _noise_cov, _robust),
    )
}
