"""Every filter on input that no theory covers: a lane stays finite, or is lost for good.

Lanes that are sound must not notice: lane 0 always is.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

from concord.features.vehicle.adaptive import correntropy, sage_husa
from concord.features.vehicle.adaptive.adaptive_filter import AdaptiveFilter
from concord.features.vehicle.adaptive.fuzzy_noise import FuzzyMatching
from concord.features.vehicle.adaptive.sage_husa import SageHusa
from concord.features.vehicle.plant.model import linear_tyre, single_track
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import cubature, scaled_unscented
from concord.filters.update import Update
from concord.papers.adlukf import dual_layer
from concord.papers.adlukf import filters as adaptive
from concord.papers.adlukf import sage_husa_as_printed as sage_husa_literal
from concord.papers.adlukf.filters import StepInput

Q = np.diag([1e-5, 1e-8, 1e-5])
R = np.diag([0.1, 0.005, 0.1]) ** 2
CONTROL = np.array([0.02, 0.1])
MODEL = single_track(BMW_320I, linear_tyre, 0.01, Q)
RULE = scaled_unscented(3, alpha=0.1, kappa=0.0)
f = partial(MODEL.transition, control=CONTROL, step=0)
h = partial(MODEL.measure, control=CONTROL)
Step = Callable[[Gaussian, Any, np.ndarray, np.ndarray], tuple[Update, Any]]


class Filter(NamedTuple):
    """`begin(Q, R (lanes, 3, 3))` and `step(belief, memory, z, Q)`."""

    begin: Callable[[np.ndarray, np.ndarray], Any]
    step: Step


def fixed(rule):
    def step(belief, noise, z, process):
        prior = ukf.predict(belief, f, process, rule)
        return ukf.update(prior, z, h, noise, rule), noise

    return Filter(lambda _, noise: noise, step)


def robust():
    def step(belief, noise, z, process):
        prior = ukf.predict(belief, f, process, RULE)
        return correntropy.update(prior, z, h, noise, RULE, 3.0), noise

    return Filter(lambda _, noise: noise, step)


def dual(form):
    def step(belief, noise, z, process):
        return form(belief, z, f, h, process, noise, RULE).update, noise

    return Filter(lambda _, noise: noise, step)


def variances(noise):
    return np.diagonal(noise, axis1=-2, axis2=-1)


def learning(law):
    own = AdaptiveFilter(SigmaPointFilter(RULE), law, RULE)

    def step(belief, memory, z, process):
        noise, learnt = memory
        update, learnt = own.update_and_learn(own.predict(belief, f, process), learnt, z, h, noise)
        return update, (noise, learnt)

    return Filter(lambda _, noise: (noise, own.begin(variances(noise).shape)), step)


def dual_learning():
    def step(belief, noise, z, process):
        update, noise = adaptive.dual_layer_step(belief, noise, StepInput(f, h, z, process))
        return update, noise

    return Filter(lambda _, noise: sage_husa.begin(variances(noise)), step)


def dual_printed(means):
    def step(belief, noise, z, process):
        update, noise = adaptive.dual_layer_literal_step(
            belief, noise, StepInput(f, h, z, process), means=means
        )
        return update, noise

    return Filter(lambda p, noise: sage_husa_literal.begin(np.diag(p), variances(noise)), step)


FILTERS = {
    "UKF": fixed(RULE),
    "CKF": fixed(cubature(3)),
    "maximum correntropy": robust(),
    "dual layer": dual(dual_layer.literal),
    "dual layer, consistent": dual(dual_layer.consistent),
    "AUKF": learning(SageHusa()),
    "FAUKF": learning(FuzzyMatching()),
    "ADLUKF": dual_learning(),
    "ADLUKF printed": dual_printed(False),
    "ADLUKF printed, q r": dual_printed(True),
}


class Case(NamedTuple):
    """Degenerate input of lane 1; lane 0 gets `R`, a definite covariance and good readings."""

    cov: np.ndarray
    noise: np.ndarray
    readings: Callable[[int], np.ndarray]
    process: np.ndarray = Q


GOOD_COV = np.diag([1e-3, 1e-3, 0.25])
GOOD = h(np.array([0.05, 0.001, 20.0]))
CASES = {
    "no measurement noise": Case(GOOD_COV, 0 * R, lambda k: GOOD),
    "no noise at all": Case(GOOD_COV, 0 * R, lambda k: GOOD, process=0 * Q),
    "a channel without noise": Case(GOOD_COV, np.diag([0.01, 0, 0.01]), lambda k: GOOD),
    "zero covariance": Case(0 * GOOD_COV, R, lambda k: GOOD),
    "singular covariance": Case(np.diag([1e-3, 0.0, 0.25]), R, lambda k: GOOD),
    "rank one": Case(np.ones((3, 3)), R, lambda k: GOOD),
    "negative covariance": Case(-GOOD_COV, R, lambda k: GOOD),
    "no reading": Case(GOOD_COV, R, lambda k: np.full(3, np.nan)),
    "a channel missing": Case(GOOD_COV, R, lambda k: np.array([np.nan, *GOOD[1:]])),
    "readings come and go": Case(GOOD_COV, R, lambda k: GOOD if k % 3 else np.full(3, np.nan)),
    "constant outliers": Case(GOOD_COV, R, lambda k: GOOD + np.array([1e3, 50.0, 500.0])),
    "alternating outliers": Case(GOOD_COV, R, lambda k: GOOD + (-1) ** k * 1e3),
    "huge readings": Case(GOOD_COV, R, lambda k: np.full(3, 1e200)),
    "infinite reading": Case(GOOD_COV, R, lambda k: np.array([np.inf, *GOOD[1:]])),
    "a constant reading": Case(GOOD_COV, R, lambda k: np.zeros(3)),
}
# By which these must fail: it would be wrong to invent a number.
HOPELESS = {"zero covariance", "singular covariance", "negative covariance", "infinite reading"}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", FILTERS)
def test_it_stays_finite_or_is_lost(name: str, case: str):
    trouble, chosen = CASES[case], FILTERS[name]
    noise = np.stack([R, trouble.noise])
    if name == "ADLUKF" and (variances(trouble.noise) == 0).any():
        with pytest.raises(ValueError, match="positive"):
            chosen.begin(trouble.process, noise)
        return
    start = np.array([0.05, 0.001, 20.0])
    belief = Gaussian(np.stack([start, start]), np.stack([GOOD_COV, trouble.cov]))
    memory = chosen.begin(trouble.process, noise)
    process = trouble.process
    lost = np.array([False, False])
    with np.errstate(all="ignore"):
        for k in range(60):
            z = np.stack([GOOD, trouble.readings(k)])
            update, memory = chosen.step(belief, memory, z, process)
            mean, cov = update.belief
            finite = np.array(
                [
                    np.isfinite(m).all() and np.isfinite(p).all()
                    for m, p in zip(mean, cov, strict=True)
                ]
            )
            assert not (lost & finite).any()
            lost = ~finite
            belief = update.belief
    assert not lost[0] or process is not Q
    if case in HOPELESS:
        assert lost[1]
