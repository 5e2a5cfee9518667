"""Filters of the nodes by name, as the values that predict and update."""

from functools import lru_cache, partial

import numpy as np

from concord.entries import chosen
from concord.filters.extended import ExtendedFilter
from concord.filters.filter import Filter, LearningFilter
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented
from concord.nodes.rules.local_filter import Model, Sensor, SensorGroup
from concord.plants.motion import CoordinatedTurn
from concord.scenarios.filter_table.filter_entry import FilterEntry
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.filters import FilterBase, NoiseLearningFilter, UserFilter
from concord.scenarios.types.rules import number_of
from concord.scenarios.user.values import ValueSource, value_of

# Affine functions pass through three points on a line to so many roundings of the values.
_ROUNDINGS = 1e-9
# Least eigenvalue of the correlations of a noise that is not singular.
_SINGULAR = 1e-13
# Least standard deviation of a noise beside its reading, which has 53 bits.
_LAST_DIGITS = 2.0**-48
# Least variance of a noise beside that of its prediction, where the two are subtracted.
_SHARPEST = 1e-14


def entry_of(choice: FilterBase) -> FilterEntry:
    """The entry of a filter in the table.

    Raises:
        ValueError: only some scenarios have the filter.
    """
    if choice.unavailable:
        raise ValueError(f"--filter {choice.name}: {choice.unavailable}")
    if isinstance(choice, UserFilter):
        return FilterEntry(lambda one, _: _user_filter(one.where), singular=True)
    found = chosen("FILTERS", choice.name)
    if not isinstance(found, FilterEntry):
        raise ValueError(
            f"--filter {choice.name}: its entry is a {type(found).__name__}; make it a FilterEntry"
        )
    return found


def build_filter(choice: FilterBase, states: int, points: SigmaPointRule | None = None) -> Filter:
    """The filter for so many states; `points` are the scenario's own sigma points, if it has any.

    Raises:
        ValueError: a file that has no such filter, or a filter of a measurement bus.
    """
    return entry_of(choice).build(choice, points or scaled_unscented(states))


def models_of(choice: FilterBase) -> int:
    """The number of models of a belief of a filter."""
    return 1 if choice.unavailable else entry_of(choice).models


def check_shares(scenario: Scenario, are_beliefs: bool) -> None:
    """Refuse a filter of several models where shares do not carry the belief of each.

    Raises:
        ValueError: naming the rule, the filter and the cure.
    """
    is_rounded = number_of(scenario.rule) == "float16"
    if models_of(scenario.filter) > 1 and (is_rounded or not are_beliefs):
        raise ValueError(
            f"rule {scenario.rule.name} with --filter {scenario.filter.name}: its shares must "
            "carry the belief of each model, as float64 or float32; use rule ci, wac or local, and "
            "leave --number out, or use --filter ukf"
        )


def learns(choice: FilterBase) -> bool:
    """Whether a filter learns from the readings of a node."""
    if isinstance(choice, UserFilter):
        return isinstance(_user_filter(choice.where), LearningFilter)
    return isinstance(choice, NoiseLearningFilter)


@lru_cache
def _user_filter(source: ValueSource) -> Filter:
    value = value_of(source)
    if not isinstance(value, Filter) or isinstance(value, type):
        raise ValueError(
            f"{source.name}: it is a {type(value).__name__}; it must be an object with the "
            "functions predict(belief, transition, noise_cov) and update(belief, measurement, "
            "measure, noise_cov, residual=..., gate=...)"
        )
    return value


def check_models(
    choice: FilterBase,
    prior: Gaussian,
    model: Model,
    groups: tuple[SensorGroup, ...],
    delivered: np.ndarray,
) -> None:
    """Refuse a filter that is none, and plants and sensors with which it cannot compute.

    `prior` is (n,); `delivered` (N, r, d) are readings of all nodes at step 0, NaN where a node
    takes none.

    Raises:
        ValueError: naming the filter, what is not linear or singular, and the cure.
    """
    entry = entry_of(choice)
    if entry.models > 1 and not isinstance(model, CoordinatedTurn):
        raise ValueError(
            f"--filter {choice.name}: its models are a straight course and a turn, and the plant "
            "has no rate of turn; use --scenario target-tracking, or --filter ukf"
        )
    build_filter(choice, len(prior.mean))
    if entry.linear:
        _require_linear(choice, prior, model, groups)
    check_prior(choice, prior, _ever_known(prior, model))
    for nodes, sensor in groups:
        for reading in np.moveaxis(delivered[nodes], -2, 0):
            value, noise_cov = sensor.interpret(reading)
            taken = np.logical_not(np.isnan(value).any(axis=-1))
            covs = np.broadcast_to(noise_cov, (*value.shape, value.shape[-1]))[taken]
            _require_noise(choice, covs)
            _require_digits(choice, entry, prior, sensor, covs, taken)


def _require_noise(choice: FilterBase, covs: np.ndarray) -> None:
    """Refuse noise covariances (..., m, m) that are singular to rounding.

    Two exact readings of one value contradict each other, and even one leaves a belief without an
    inverse, which no fusion takes.
    """
    deviations = np.sqrt(np.diagonal(covs, axis1=-2, axis2=-1))
    scale = deviations[..., :, None] * deviations[..., None, :]
    correlations = covs / np.where(scale > 0, scale, np.nan)
    if np.isnan(cholesky(correlations - _SINGULAR * np.eye(covs.shape[-1]))).any():
        raise ValueError(
            f"--filter {choice.name}: the noise covariance R of a sensor is singular, so the "
            "covariance after its reading is too, and no rule can fuse that; give each entry of a "
            "reading a variance above 0, such as the square of its resolution over 12"
        )


def _require_digits(
    choice: FilterBase,
    entry: FilterEntry,
    prior: Gaussian,
    sensor: Sensor,
    covs: np.ndarray,
    taken: np.ndarray,
) -> None:
    """Refuse noise covariances (K, m, m) of readings that were taken (N,), whose size is lost in
    the digits of the readings or of their predicted variances."""
    lanes = Gaussian(
        np.broadcast_to(prior.mean, (len(taken), *prior.mean.shape)),
        np.broadcast_to(prior.cov, (len(taken), *prior.cov.shape)),
    )
    measure, m = partial(sensor.measure, step=0), covs.shape[-1]
    predicted, slope, _ = ExtendedFilter().linearise(lanes, measure, m, sensor.residual)
    variances = np.diagonal(slope @ lanes.cov @ slope.mT, axis1=-2, axis2=-1)[taken]
    noise = np.diagonal(covs, axis1=-2, axis2=-1)
    least = (_LAST_DIGITS * (np.abs(predicted[taken]) + np.sqrt(variances))) ** 2
    if (lost := np.argwhere(noise < least)).size:
        at = tuple(lost[0])
        raise ValueError(
            f"--filter {choice.name}: the noise covariance R of a sensor has a variance of "
            f"{noise[at]:.3g}, which is lost in the last digits of readings near "
            f"{predicted[taken][at]:.3g}; raise it to {least[at]:.1g} at least, or put the origin "
            "nearer to the plant"
        )
    if entry.square_root or isinstance(choice, UserFilter):
        return
    if (lost := np.argwhere(noise < _SHARPEST * variances)).size:
        at = tuple(lost[0])
        raise ValueError(
            f"--filter {choice.name}: the noise covariance R of a sensor has a variance of "
            f"{noise[at]:.3g}, and its prediction one of {variances[at]:.3g}; their difference has "
            "no digits left; use --filter ukf, which takes such readings in square-root form, or "
            f"raise R to {_SHARPEST * variances[at]:.1g}"
        )


def _ever_known(prior: Gaussian, model: Model) -> bool:
    """Whether the process noise leaves a direction of the state known for certain."""
    belief, filter = prior, ExtendedFilter()
    for step in range(len(prior.mean)):
        if not np.isnan(cholesky(belief.cov)).any():
            return False
        noise_cov = model.process_noise_cov(step)
        transition = partial(model.transition, control=None, step=step)
        belief = filter.predict(belief, transition, noise_cov)
    return bool(np.isnan(cholesky(belief.cov)).any())


def check_prior(choice: FilterBase, prior: Gaussian, ever_known: bool = False) -> None:
    """Refuse a singular prior (n,) for a filter of Gaussian beliefs that needs a Cholesky factor.

    `ever_known`: a direction stays known for certain, so that no filter gets a belief with an
    inverse, which fusion needs.

    Raises:
        ValueError: naming the filter and the cure.
    """
    is_taken = choice.set_valued or (not choice.unavailable and entry_of(choice).singular)
    if (is_taken and not ever_known) or not np.isnan(cholesky(prior.cov)).any():
        return
    if ever_known:
        raise ValueError(
            f"--filter {choice.name}: the covariance of the prior is singular, and the process "
            "noise Q never changes that, so no rule can fuse such beliefs; give each state a "
            "variance above 0, or put what is known for certain into f"
        )
    raise ValueError(
        f"--filter {choice.name}: the covariance of the prior is singular, and this filter "
        "needs its Cholesky factor; give each state a variance above 0, or use --filter ekf"
    )


def _require_linear(
    choice: FilterBase, prior: Gaussian, model: Model, groups: tuple[SensorGroup, ...]
) -> None:
    deviation = np.sqrt(np.diagonal(prior.cov))
    functions = [("the plant", partial(model.transition, control=None, step=0), np.subtract)]
    functions += [
        ("a sensor", partial(sensor.measure, step=0), sensor.residual) for _, sensor in groups
    ]
    # Each state by itself, and all of them at once.
    away = np.concatenate([np.diag(deviation), deviation[None]])[:, None, None]
    for what, function, residual in functions:
        ahead, middle, behind = (function(prior.mean + by) for by in (away, 0 * away, -away))
        rise, fall = residual(ahead, middle), residual(middle, behind)
        scale = np.abs(rise).max() + np.abs(middle).max()
        if np.abs(rise - fall).max() > _ROUNDINGS * scale:
            raise ValueError(
                f"--filter {choice.name}: {what} is not linear over one standard deviation of the "
                "prior, and the Kalman filter is for linear models; use --filter ekf or ukf"
            )
