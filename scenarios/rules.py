"""Fusion rules and hold policies by name, as the values that a node is built from."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from concord.features.sets import set_rules
from concord.features.sets.set_shapes import Ellipsoids, Zonotopes
from concord.filters.fusion import hold
from concord.filters.fusion.averaging import INFORMATION, MOMENTS, Directly
from concord.filters.fusion.hybrid_consensus import classical_gain, safe_gain
from concord.filters.fusion.local import keep_own
from concord.filters.fusion.sharp_intersection import SharpIntersection
from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import AnyEstimator
from concord.nodes.lanes.network import BatchedRule
from concord.nodes.rules.belief_consensus import HoldPolicy
from concord.scenarios.estimators import (
    BuildRule,
    alone_in_batch,
    at_node,
    averages_in_batch,
    averaging,
    beliefs_in_batch,
    diffused,
    flooding,
    flooding_in_batch,
    hybrid,
    in_batch,
    pulled,
    set_at_node,
    trimmed,
    weighted_information,
)
from concord.scenarios.filters import check_shares, models_of
from concord.scenarios.labelled import check_labelled, largest_share, without_arrays
from concord.scenarios.node_context import BatchContext, NodeContext
from concord.scenarios.scenario import Scenario, lossy_links
from concord.scenarios.setup import Setup
from concord.scenarios.share_kinds import (
    BELIEFS,
    ELLIPSOIDS,
    HYBRID,
    INFORMATION_PAIRS,
    NOVELTIES,
    NOVELTIES_AND_MEANS,
    ZONOTOPES,
    ShareKind,
)
from concord.scenarios.types.buses import FullSchedule
from concord.scenarios.types.filters import SetFilter
from concord.scenarios.types.holds import Decayed, Dropped, Fading, InStep, Predicted, Raw
from concord.scenarios.types.rules import (
    NumberRule,
    TrimmedCovarianceIntersection,
    UserRule,
    hold_of,
    number_of,
)
from concord.scenarios.user.values import ValueSource, function_or
from concord.topology.names import unknown_name

if TYPE_CHECKING:
    from concord.topology.weights import Weights

Average = Callable[[Gaussian, np.ndarray], Gaussian]
"""The beliefs (..., J, n) of a neighbourhood, the own first, and weights (..., J) -> belief."""
_NUMBERS = {"float64": "<f8", "float32": "<f4", "float16": "<u2"}


class Rule(NamedTuple):
    """A fusion rule of the network.

    Attributes:
        share: what its shares are; None for shares of any length up to the payload of a frame.
        estimator: builds that of one node.
        batched: builds the rule at all nodes of many runs.
        check: refuses scenario, neighbours of each node and weights (N, N) that it cannot do with.
        set_valued: covariances are shape matrices of ellipsoids that hold the truth for certain.
        baseline_filter: (setup, nodes, readings (steps, N, r, d), control (steps, p) or None) ->
            beliefs (steps,) of one filter that takes the readings of these nodes; None for the
            Gaussian filter of the scenario.
        lacking: what of a scenario the batched rule does not have; None if it has all.
        weighted: the network's consensus weights are used.
    """

    share: ShareKind | None
    estimator: Callable[[NodeContext], AnyEstimator]
    batched: Callable[[BatchContext], BatchedRule]
    check: "Callable[[Scenario, Sequence[Sequence[int]], Weights], None] | None" = None
    set_valued: bool = False
    baseline_filter: (
        Callable[[Setup, Sequence[int], np.ndarray, np.ndarray | None], Gaussian] | None
    ) = None
    lacking: Callable[[Scenario], str | None] = lambda _: None
    weighted: bool = True

    @property
    def shares_beliefs(self) -> bool:
        """Whether a share is a mean and a covariance."""
        return self.share is BELIEFS


def rule_of(scenario: Scenario) -> Rule:
    """The scenario's rule.

    Raises:
        ValueError: there is no such rule.
    """
    if isinstance(scenario.rule, UserRule):
        return _user_rule(scenario.rule.where)
    if why := scenario.rule.unavailable:
        raise ValueError(f"rule {scenario.rule.name}: {why}; use one of these, or another rule")
    if scenario.rule.name not in _RULES:
        raise unknown_name("rule", scenario.rule.name, _RULES)
    return _RULES[scenario.rule.name]


@lru_cache
def _user_rule(source: ValueSource) -> Rule:
    """The rule of a user: an average of beliefs, or a `Rule` that says everything itself."""
    value = function_or(Rule, source, "a function rule(beliefs, weights) -> belief, or a Rule")
    return value if isinstance(value, Rule) else _averaged(value)


def is_set_valued(scenario: Scenario) -> bool:
    """Whether its estimates are sets that hold the truth for certain."""
    if scenario.rule.unavailable:
        return isinstance(scenario.filter, SetFilter)
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
    share = rule_of(scenario).share
    if share is None:
        return largest_share(scenario, states)
    number, models = wire_number(scenario), models_of(scenario.filter)
    return share.codec(number, states, scenario.nodes, models).size


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


# --- the rules -----------------------------------------------------------------------------------


def _require_form(scenario: Scenario, rule: Rule) -> None:
    check_shares(scenario, rule.shares_beliefs)
    if rule.share is None or rule.share.has(wire_number(scenario)):
        return
    raise ValueError(
        f"rule {scenario.rule.name} --number {number_of(scenario.rule)}: its shares carry no "
        "covariance that could be enlarged by what two bytes a number lose; use --number float32, "
        "or a rule that shares beliefs such as ci or hcmci"
    )


def _require_the_average(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    # Only here: a check of a scenario may be slow to start, a node of the network may not.
    from concord.topology.weights import check_doubly_stochastic

    try:
        check_doubly_stochastic(weights)
    except ValueError as error:
        raise ValueError(
            f"rule {scenario.rule.name} multiplies the network's average by the number of nodes, "
            f"and needs weights that lead there: {error}; or choose rule hcmci, which takes any"
        ) from None


def _require_honest_majorities(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    assert isinstance(scenario.rule, TrimmedCovarianceIntersection), "the table of rules chose it"
    liars = scenario.rule.liars
    # A node without neighbours hears no liar.
    needed = 2 * liars if len(neighbours) > 1 else 0
    few = [node for node, heard in enumerate(neighbours) if len(heard) < needed]
    if few:
        raise ValueError(
            f"rule trimmed-ci --liars {liars} on graph {scenario.network.graph}: node {few[0]} "
            f"hears {len(neighbours[few[0]])} neighbours and must hear {needed} to tell liars from "
            "others; use a denser --graph, fewer --liars, or rule ci, which believes everybody"
        )


def _require_all_at_once(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    everybody = len(neighbours) - 1
    deaf = [node for node, heard in enumerate(neighbours) if len(heard) < everybody]
    if deaf:
        raise ValueError(
            f"rule centralised on graph {scenario.network.graph}: node {deaf[0]} hears "
            f"{len(neighbours[deaf[0]])} of {everybody} others, and must hear all; use --graph "
            "complete, or rule hcmci, which comes near the centralised filter on any graph"
        )
    schedule = scenario.bus.schedule
    if not isinstance(schedule, FullSchedule):
        raise ValueError(
            f"rule centralised with --schedule {schedule.name}: every node must publish in "
            "every cycle; use --schedule full, or rule hcmci or ci, which do with less"
        )
    if lossy := lossy_links(scenario):
        raise ValueError(
            f"rule centralised with {lossy}: every node must hear all others in "
            "every step; leave that out, or use rule hcmci or ci, which do with less"
        )
    if scenario.rounds != 1:
        raise ValueError(
            f"rule centralised with --rounds {scenario.rounds}: one round tells everybody all, "
            "and a second would tell it twice; use --rounds 1"
        )


def _once(
    share: ShareKind,
    build: BuildRule,
    batched: Callable[[BatchContext], BatchedRule] | None = None,
    **properties: Any,
) -> Rule:
    """A rule that is written once: `build` serves one node and all nodes of many runs.

    `batched` is a faster form for many runs.
    """
    at_one = partial(at_node, build, share)
    at_all = batched or partial(in_batch, build, share)
    return Rule(share, at_one, at_all, **properties)


def _averaged(average: Average) -> Rule:
    """A rule that is a function of the beliefs (..., J, n) of a neighbourhood and of weights."""
    return _once(BELIEFS, partial(averaging, Directly(average)))


_RULES: dict[str, Rule] = {
    "ci": _once(
        BELIEFS,
        partial(averaging, INFORMATION),
        partial(beliefs_in_batch, INFORMATION),
    ),
    "sharp-ci": _once(BELIEFS, partial(averaging, SharpIntersection())),
    "trimmed-ci": _once(
        BELIEFS,
        trimmed,
        check=_require_honest_majorities,
    ),
    "wac": _once(
        BELIEFS,
        partial(averaging, MOMENTS),
        partial(beliefs_in_batch, MOMENTS),
    ),
    "hcmci": _once(
        HYBRID,
        partial(hybrid, safe_gain),
        partial(averages_in_batch, partial(hybrid, safe_gain), HYBRID),
    ),
    "hcmci-classical": _once(
        HYBRID,
        partial(hybrid, classical_gain),
        partial(averages_in_batch, partial(hybrid, classical_gain), HYBRID),
        check=_require_the_average,
    ),
    "icf": _once(
        INFORMATION_PAIRS,
        weighted_information,
        partial(averages_in_batch, weighted_information, INFORMATION_PAIRS),
        check=_require_the_average,
    ),
    "diffusion": _once(NOVELTIES, diffused),
    "kcf": _once(NOVELTIES_AND_MEANS, pulled, weighted=False),
    "labelled": Rule(
        None,
        flooding,
        flooding_in_batch,
        check=check_labelled,
        lacking=without_arrays,
        weighted=False,
    ),
    "labelled-ellipsoid": Rule(
        None,
        flooding,
        flooding_in_batch,
        check=set_rules.check_labelled_sets,
        set_valued=True,
        baseline_filter=partial(set_rules.baseline_filter, Ellipsoids),
        lacking=without_arrays,
        weighted=False,
    ),
    "local": _once(
        BELIEFS,
        partial(averaging, Directly(keep_own)),
        alone_in_batch,
        weighted=False,
    ),
    "centralised": _once(
        NOVELTIES,
        diffused,
        check=_require_all_at_once,
        weighted=False,
    ),
    "ellipsoid": Rule(
        ELLIPSOIDS,
        partial(set_at_node, partial(set_rules.set_membership, Ellipsoids), ELLIPSOIDS),
        partial(in_batch, partial(set_rules.set_membership, Ellipsoids), ELLIPSOIDS),
        check=set_rules.check_bounded,
        set_valued=True,
        baseline_filter=partial(set_rules.baseline_filter, Ellipsoids),
        weighted=False,
    ),
    "zonotope": Rule(
        ZONOTOPES,
        partial(set_at_node, partial(set_rules.set_membership, Zonotopes), ZONOTOPES),
        partial(in_batch, partial(set_rules.set_membership, Zonotopes), ZONOTOPES),
        check=set_rules.check_bounded,
        set_valued=True,
        baseline_filter=partial(set_rules.baseline_filter, Zonotopes),
        weighted=False,
    ),
}
