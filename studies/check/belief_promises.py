"""Promises of a rule that is a function of the beliefs (..., J, n) of a neighbourhood and weights.

Each function returns how the rule breaks the promise on one drawn neighbourhood, "" if it holds.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees
from concord.results.figures.intervals import mean_t
from concord.scenarios.rule_table.rules_of_beliefs import Average
from concord.studies.check.neighbourhoods import (
    LANES,
    Neighbourhood,
    apart,
    at_lane,
    normalised,
)
from concord.studies.check.promise import (
    PromiseBroken,
    amount,
    covariance_fault,
)

# Of means in standard deviations, and of covariances in those of both states.
_ROUNDING = 1e-7
# A correct rule fails the Monte Carlo of one case with a chance of one in a million.
_CONFIDENCE = 1 - 2e-6
_SAMPLES = 4000
_CORRELATIONS = {"copies of one belief": 1.0, "fully correlated errors": 1.0,
                 "partly correlated errors": 0.5, "independent errors": 0.0}  # fmt: skip


class BeliefPromise(NamedTuple):
    """A promise about beliefs.

    Attributes:
        fewest: the fewest neighbours that it needs.
        claimed: "always"; "consistent" where only a rule that claims consistency promises it;
            "never" for a fact that is good to know.
    """

    name: str
    says: str
    seen: Callable[[Average, Neighbourhood], str]
    fewest: int = 1
    claimed: str = "always"


def with_shapes_checked(rule: Average) -> Average:
    """Return the same rule; it raises `PromiseBroken` for a result of another shape."""

    def average(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
        mean, cov = map(np.asarray, rule(beliefs, weights))
        *lanes, _, n = beliefs.mean.shape
        if (mean.shape, cov.shape) != ((*lanes, n), (*lanes, n, n)):
            raise PromiseBroken(
                f"means of shape {beliefs.mean.shape} give a mean {mean.shape} and a covariance "
                f"{cov.shape}: must be {(*lanes, n)} and {(*lanes, n, n)}"
            )
        return Gaussian(mean, cov)

    return average


def _each_lane_has_its_own_result(rule: Average, case: Neighbourhood) -> str:
    together = rule(case.beliefs, case.weights)
    for lane in np.ndindex(LANES):
        alone = rule(at_lane(case.beliefs, lane), case.weights[lane])
        if (off := apart(alone, at_lane(together, lane))) > _ROUNDING:
            return f"lane {lane} of {LANES} differs {amount(off)} from the same lane alone"
    return ""


def _failed_lanes_fail_alone(rule: Average, case: Neighbourhood) -> str:
    before = rule(case.beliefs, case.weights)
    others = np.arange(np.prod(LANES)).reshape(LANES) > 0
    for what, value in (("NaN", np.nan), ("0", 0.0)):
        mean, cov = (part.copy() for part in case.beliefs)
        mean[0, 0], cov[0, 0] = value, value
        after = rule(Gaussian(mean, cov), case.weights)
        off = apart(
            Gaussian(after.mean[others], after.cov[others]),
            Gaussian(before.mean[others], before.cov[others]),
        )
        if off > _ROUNDING:
            return f"with {what} in lane (0, 0), other lanes move {amount(off)}"
    return ""


def _unheard_neighbours_change_nothing(rule: Average, case: Neighbourhood) -> str:
    heard = slice(case.neighbours)
    weights = case.weights.copy()
    weights[..., -1] = 0.0
    weights = normalised(weights)
    mean, cov = case.beliefs
    without = rule(Gaussian(mean[..., heard, :], cov[..., heard, :, :]), weights[..., heard])
    eye = np.eye(case.states)
    for what, its_mean, its_cov in (
        ("far away", 1e6, eye), ("surer than all", 0.0, 1e-9 * eye), ("NaN", np.nan, np.nan * eye),
        ("no covariance", 0.0, -eye),
    ):  # fmt: skip
        mean, cov = (part.copy() for part in case.beliefs)
        mean[..., -1, :], cov[..., -1, :, :] = its_mean, its_cov
        off = apart(rule(Gaussian(mean, cov), weights), without)
        if off > _ROUNDING:
            return f"a belief of weight 0 that is {what} moves the result {amount(off)}"
    return ""


def _equal_beliefs_stay_equal(rule: Average, case: Neighbourhood) -> str:
    own = Gaussian(*(part[:, :, :1] for part in case.beliefs))
    copies = Gaussian(
        np.repeat(own.mean, 1 + case.neighbours, axis=2),
        np.repeat(own.cov, 1 + case.neighbours, axis=2),
    )
    mean, cov = rule(copies, case.weights)
    deviation = np.sqrt(np.diagonal(own.cov[:, :, 0], axis1=-2, axis2=-1))
    off = float((np.abs(mean - own.mean[:, :, 0]) / deviation).max())
    if not off <= _ROUNDING:
        return f"the mean of equal beliefs is another one {amount(off)}"
    whitener = np.linalg.inv(np.linalg.cholesky(own.cov[:, :, 0]))
    least = float(np.linalg.eigvalsh(whitener @ cov @ whitener.mT).min())
    if not least >= 1 - _ROUNDING:
        return f"{1 + case.neighbours} equal beliefs give {least:.4g} of their variance"
    return ""


def _order_does_not_matter(rule: Average, case: Neighbourhood) -> str:
    before = rule(case.beliefs, case.weights)
    mixed = 1 + case.generator.permutation(case.neighbours)
    for places in (np.arange(case.neighbours, 0, -1), mixed):
        order = np.concatenate(([0], places))
        mean, cov = case.beliefs
        after = rule(Gaussian(mean[..., order, :], cov[..., order, :, :]), case.weights[..., order])
        if (off := apart(after, before)) > _ROUNDING:
            return f"neighbours in the order {places.tolist()} move the result {amount(off)}"
    return ""


def _results_are_covariances(rule: Average, case: Neighbourhood) -> str:
    return covariance_fault(*rule(case.beliefs, case.weights), _ROUNDING)


def _covariance_covers_the_error(rule: Average, case: Neighbourhood) -> str:
    for what, shared in _CORRELATIONS.items():
        errors, covs = _sampled(case, what.startswith("copies"), shared)
        weights = np.broadcast_to(case.weights[0, 0], errors.shape[:-1])
        mean, cov = rule(Gaussian(errors, covs), weights)
        found = mean_t(nees(mean, cov) / case.states, _CONFIDENCE)
        if found.low > 1:
            return (
                f"{what}: squared errors are {found.value:.3g} times as large as believed "
                f"({found.low:.3g} to {found.high:.3g})"
            )
    return ""


def _sampled(case: Neighbourhood, copies: bool, shared: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors (samples, 1 + J, n) and covariances of the first lane's beliefs; `shared` is the part
    of each error that all of them have."""
    covs = case.beliefs.cov[0, 0]
    if copies:
        covs = np.broadcast_to(covs[0], covs.shape)
    generator = case.generator
    own = generator.standard_normal((_SAMPLES, *covs.shape[:-1]))
    common = generator.standard_normal((_SAMPLES, 1, case.states))
    white = np.sqrt(shared) * common + np.sqrt(1 - shared) * own
    errors = (np.linalg.cholesky(covs) @ white[..., None])[..., 0]
    return errors, np.broadcast_to(covs, (_SAMPLES, *covs.shape))


def _units_do_not_matter(rule: Average, case: Neighbourhood) -> str:
    scale = np.exp(case.generator.uniform(-3, 3, case.states))
    both = scale[:, None] * scale
    mean, cov = rule(case.beliefs, case.weights)
    before = Gaussian(mean * scale, cov * both)
    other = Gaussian(case.beliefs.mean * scale, case.beliefs.cov * both)
    off = apart(rule(other, case.weights), before)
    return "" if off <= _ROUNDING else f"other units of the states move the result {amount(off)}"


BELIEF_PROMISES = (
    BeliefPromise("lanes", "each lane (R, N) has its own result", _each_lane_has_its_own_result),
    BeliefPromise("failed-lanes", "a lane of NaN fails alone", _failed_lanes_fail_alone),
    BeliefPromise(
        "unheard", "a neighbour of weight 0 changes nothing", _unheard_neighbours_change_nothing
    ),
    BeliefPromise("equal", "equal beliefs keep mean and covariance", _equal_beliefs_stay_equal),
    BeliefPromise("order", "the order of neighbours does not matter", _order_does_not_matter, 2),
    BeliefPromise(
        "covariance", "results are finite, cov positive definite", _results_are_covariances
    ),
    BeliefPromise(
        "consistent",
        "the covariance covers the error",
        _covariance_covers_the_error,
        claimed="consistent",
    ),
    BeliefPromise(
        "units", "units of the states do not matter", _units_do_not_matter, claimed="never"
    ),
)
