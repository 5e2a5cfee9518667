"""Filters of the nodes by name, as the values that predict and update."""

from functools import lru_cache, partial

import numpy as np

from concord.entries import chosen
from concord.filters.filter import Filter, LearningFilter
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented
from concord.nodes.rules.local_filter import Model, SensorGroup
from concord.plants.motion import CoordinatedTurn
from concord.scenarios.filter_table.filter_entry import FilterEntry
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.filters import FilterBase, NoiseLearningFilter, UserFilter
from concord.scenarios.types.rules import number_of
from concord.scenarios.user.values import ValueSource, value_of

# Affine functions pass through three points on a line to so many roundings of the values.
_ROUNDINGS = 1e-9


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
    check_prior(choice, prior)
    if entry.singular:
        return
    for nodes, sensor in groups:
        for reading in np.moveaxis(delivered[nodes], -2, 0):
            value, noise_cov = sensor.interpret(reading)
            taken = np.logical_not(np.isnan(value).any(axis=-1))
            covs = np.broadcast_to(noise_cov, (*value.shape, value.shape[-1]))[taken]
            if np.isnan(cholesky(covs)).any():
                raise ValueError(
                    f"--filter {choice.name}: the noise covariance R of a sensor is singular, so "
                    "the covariance after its reading is too; give each entry of a reading a "
                    "variance above 0, or use --filter ekf"
                )


def check_prior(choice: FilterBase, prior: Gaussian) -> None:
    """Refuse a singular prior (n,) for a filter of Gaussian beliefs that needs a Cholesky factor.

    Raises:
        ValueError: naming the filter and the cure.
    """
    if choice.set_valued or (not choice.unavailable and entry_of(choice).singular):
        return
    if np.isnan(cholesky(prior.cov)).any():
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
