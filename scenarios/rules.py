"""Fusion rules and hold policies by name, as the values that a node is built from."""

from collections.abc import Callable
from functools import partial

import numpy as np

from filters import hold
from filters.fusion import covariance_intersection, weighted_average
from filters.gaussian import Gaussian
from nodes.belief_consensus import HoldPolicy
from scenarios.scenario import Scenario
from topology.names import unknown_name

RULES: dict[str, Callable[[Gaussian, np.ndarray], Gaussian]] = {
    "ci": covariance_intersection,
    "wac": weighted_average,
}
RULE_SUMMARIES = {
    "ci": "covariance intersection: consistent for any correlation, never less tight than wac",
    "wac": "weighted average of means and covariances (the paper's): no inverse, may diverge",
}
_NUMBERS = {"float64": "<f8", "float32": "<f4"}


def average_of(scenario: Scenario) -> Callable[[Gaussian, np.ndarray], Gaussian]:
    """The function (beliefs, weights) -> belief of the scenario's rule.

    Raises:
        ValueError: there is no such rule.
    """
    if scenario.rule not in RULES:
        raise unknown_name("rule", scenario.rule, RULES)
    return RULES[scenario.rule]


def hold_policy(scenario: Scenario) -> HoldPolicy:
    """The scenario's hold policy.

    Raises:
        ValueError: there is no such policy.
    """
    if scenario.hold not in _HOLDS:
        raise unknown_name("hold", scenario.hold, _HOLDS)
    return _HOLDS[scenario.hold](scenario)


def hold_names() -> tuple[str, ...]:
    """The hold policies there are."""
    return tuple(_HOLDS)


def wire_number(scenario: Scenario) -> str:
    """The numpy type code of numbers in a share."""
    return _NUMBERS[scenario.number]


def _decayed(
    decay: float,
    determinant_weights: bool,
    base_weights: np.ndarray,
    ages: np.ndarray,
    covs: np.ndarray,
    _cycles_in_step: int,
) -> np.ndarray:
    return hold.held_weights(base_weights, ages, covs, decay, determinant_weights)


def _by_age(
    weigh: Callable[[np.ndarray, np.ndarray], np.ndarray],
    base_weights: np.ndarray,
    ages: np.ndarray,
    _covs: np.ndarray,
    _cycles_in_step: int,
) -> np.ndarray:
    return weigh(base_weights, ages)


def _in_step(
    base_weights: np.ndarray, ages: np.ndarray, _covs: np.ndarray, cycles_in_step: int
) -> np.ndarray:
    return hold.in_step(base_weights, ages, cycles_in_step)


_HOLDS: dict[str, Callable[[Scenario], HoldPolicy]] = {
    "decayed": lambda s: HoldPolicy(
        partial(_decayed, s.decay, s.determinant_weights), carried=True
    ),
    "predict": lambda _: HoldPolicy(partial(_by_age, hold.full), carried=True),
    "raw": lambda _: HoldPolicy(partial(_by_age, hold.full), carried=False),
    "drop": lambda _: HoldPolicy(partial(_by_age, hold.drop), carried=False),
    "renormalise": lambda _: HoldPolicy(partial(_by_age, hold.renormalise), carried=False),
    "in-step": lambda _: HoldPolicy(_in_step, carried=False),
}
