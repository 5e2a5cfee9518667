"""Fusion rules and hold policies by name, as the values that a node is built from."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from concord.entries import chosen
from concord.filters.filter import begun
from concord.filters.fusion import hold
from concord.filters.gaussian import Gaussian
from concord.filters.turns import angles_of
from concord.nodes.estimator import AnyEstimator
from concord.nodes.rules.belief_consensus import HoldPolicy
from concord.scenarios.catalogue import definition_of
from concord.scenarios.filter_table.filters import build_filter, check_shares, models_of
from concord.scenarios.node_context import NodeContext
from concord.scenarios.rule_table.rule import Rule
from concord.scenarios.rule_table.rules_of_beliefs import Average, averaged
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.holds import Decayed, Dropped, Fading, InStep, Predicted, Raw
from concord.scenarios.types.rules import NumberRule, UserRule, hold_of, number_of
from concord.scenarios.user.values import ValueSource, function_or

if TYPE_CHECKING:
    from concord.topology.weights import Weights

_NUMBERS = {"float64": "<f8", "float32": "<f4", "float16": "<u2"}


def rule_of(scenario: Scenario) -> Rule:
    """The scenario's rule.

    Raises:
        ValueError: there is no such rule.
    """
    if isinstance(scenario.rule, UserRule):
        own = _user_rule(scenario.rule.where)
        return own if isinstance(own, Rule) else averaged(own)
    if why := scenario.rule.unavailable:
        raise ValueError(f"rule {scenario.rule.name}: {why}; use one of these, or another rule")
    return _named(scenario.rule.name)


@lru_cache
def _named(name: str) -> Rule:
    """The rule of a name: an average of beliefs, or a `Rule` that says everything itself."""
    value = chosen("RULES", name)
    return value if isinstance(value, Rule) else averaged(value)


@lru_cache
def _user_rule(source: ValueSource) -> Rule | Average:
    """The rule of a user: an average of beliefs, or a `Rule` that says everything itself."""
    return function_or(Rule, source, "a function rule(beliefs, weights) -> belief, or a Rule")


def try_own_rule(scenario: Scenario, prior: Gaussian, neighbours: Sequence[Sequence[int]]) -> None:
    """Call a rule of the user's own on as many beliefs near the prior (n,) as a node may have.

    Raises:
        ValueError: naming the rule, what is wrong with it, and the cure.
    """
    rule = scenario.rule
    if isinstance(rule, UserRule) and not isinstance(own := _user_rule(rule.where), Rule):
        # Only here: a node of the network tries nothing.
        from concord.scenarios.user.trial import try_rule

        deviation = np.sqrt(np.diagonal(prior.cov))
        deviation = np.where(deviation > 0, deviation, 1.0)
        # No covariance is diagonal after a fusion, so that of the prior would show too little.
        correlations = 0.7 * np.eye(len(deviation)) + 0.3
        prior = Gaussian(prior.mean, deviation[:, None] * correlations * deviation)
        begins = begun(build_filter(scenario.filter, len(deviation)), prior)
        try_rule(rule.name, own, begins, 1 + max(map(len, neighbours)))


def is_set_valued(scenario: Scenario) -> bool:
    """Whether its estimates are sets that hold the truth for certain."""
    if scenario.rule.unavailable:
        return scenario.filter.set_valued
    return rule_of(scenario).set_valued


def check_rule(scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights") -> None:
    """Refuse a rule on a network that it cannot run on, or with a hold policy that it cannot use.

    Raises:
        ValueError: naming the rule, what is in its way, and the cure.
    """
    rule = rule_of(scenario)
    _require_form(scenario, rule)
    if rule.check is not None:
        rule.check(scenario, neighbours, weights)


def build_estimator(scenario: Scenario, context: NodeContext) -> AnyEstimator:
    """The estimator at one node.

    Raises:
        ValueError: there is no such rule.
    """
    return rule_of(scenario).estimator(context)


def share_size(scenario: Scenario, states: int) -> int:
    """Length in bytes of the longest share in a network whose plant has so many states."""
    rule = rule_of(scenario)
    share = rule.share
    if share is None:
        assert rule.share_bytes is not None, "a rule without a kind of share says their length"
        return rule.share_bytes(scenario, states)
    number, models = wire_number(scenario), models_of(scenario.filter)
    angles = angles_of(definition_of(scenario).model(scenario))
    return share.of(angles).codec(number, states, scenario.nodes, models).size


def hold_policy(scenario: Scenario) -> HoldPolicy:
    """The scenario's hold policy; that of `Renormalised` for a rule that holds nothing."""
    match hold_of(scenario.rule):
        case Fading(decay=decay) as held:
            by_determinant = isinstance(held, Decayed) and held.determinant_weights
            return HoldPolicy(
                partial(_decayed, decay), carried=True, by_inverse_volume=by_determinant
            )
        case Predicted():
            return HoldPolicy(partial(_by_age, hold.full), carried=True)
        case Raw():
            return HoldPolicy(partial(_by_age, hold.full), carried=False)
        case Dropped():
            return HoldPolicy(partial(_by_age, hold.drop), carried=False)
        case InStep():
            return HoldPolicy(_in_step, carried=False)
    return HoldPolicy(partial(_by_age, hold.renormalise), carried=False)


def wire_number(scenario: Scenario) -> str:
    """The numpy type code of numbers in a share."""
    rule = scenario.rule
    return _NUMBERS[rule.number if isinstance(rule, NumberRule) else "float64"]


# --- hold policies -------------------------------------------------------------------------------


def _decayed(
    decay: float,
    base_weights: np.ndarray,
    ages: np.ndarray,
    inverse_volume: np.ndarray,
    _cycles_in_step: int,
) -> np.ndarray:
    return hold.held_weights(base_weights, ages, decay, inverse_volume)


def _by_age(
    weigh: Callable[[np.ndarray, np.ndarray], np.ndarray],
    base_weights: np.ndarray,
    ages: np.ndarray,
    _inverse_volume: np.ndarray,
    _cycles_in_step: int,
) -> np.ndarray:
    return weigh(base_weights, ages)


def _in_step(
    base_weights: np.ndarray, ages: np.ndarray, _inverse_volume: np.ndarray, cycles_in_step: int
) -> np.ndarray:
    return hold.in_step(base_weights, ages, cycles_in_step)


def _require_form(scenario: Scenario, rule: Rule) -> None:
    check_shares(scenario, rule.shares_beliefs)
    if rule.share is None or rule.share.has(wire_number(scenario)):
        return
    raise ValueError(
        f"rule {scenario.rule.name} --number {number_of(scenario.rule)}: its shares carry no "
        "covariance that could be enlarged by what two bytes a number lose; use --number float32, "
        "or a rule that shares beliefs such as ci or hcmci"
    )
