"""Rules that average the beliefs of a neighbourhood: ci, sharp-ci, trimmed-ci, wac, local."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from concord.filters.fusion import hold
from concord.filters.fusion.averaging import INFORMATION, MOMENTS, Averaged, Averaging, Directly
from concord.filters.fusion.hold import keep_own
from concord.filters.fusion.sharp_intersection import SharpIntersection
from concord.filters.fusion.trimmed import trimmed_intersection
from concord.filters.gaussian import Gaussian, stacked_size
from concord.nodes.rules.belief_consensus import BeliefConsensus, HoldPolicy
from concord.scenarios.node_context import BatchContext, RuleContext
from concord.scenarios.rule_table.rule import BELIEFS, AnyRule, Rule, once, share_codec
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.rules import TrimmedCovarianceIntersection

if TYPE_CHECKING:
    from concord.nodes.lanes.network import BatchedRule
    from concord.topology.weights import Weights

Average = Callable[[Gaussian, np.ndarray], Gaussian]
"""The beliefs (..., J, n) of a neighbourhood, the own first, and weights (..., J) -> belief."""


def averaging(rule: Averaged, context: RuleContext) -> AnyRule:
    """For rules that average beliefs, fresh ones and held ones."""
    size = stacked_size(context.states, context.models)
    asks = context.trigger, context.contends
    return BeliefConsensus(rule, context.hold, size, *asks, context.angles)


def averaged(average: Average) -> Rule:
    """A rule that is a function of the beliefs (..., J, n) of a neighbourhood and of weights."""
    return once(BELIEFS, partial(averaging, Directly(average)))


def trimmed(context: RuleContext) -> AnyRule:
    """For covariance intersection among liars: their own claims give no weight."""
    rule = context.rule
    assert isinstance(rule, TrimmedCovarianceIntersection), "the table of rules chose it"
    return averaging(Directly(partial(trimmed_intersection, liars=rule.liars)), context)


def beliefs_in_batch(rule: Averaging, context: BatchContext) -> "BatchedRule":
    """The matrix form of rules that average beliefs."""
    # Only here: a node computes without arrays of nodes.
    from concord.nodes.lanes.beliefs import BatchedBeliefs

    return BatchedBeliefs(
        filters=context.filters,
        averaging=rule,
        hold=context.rule.hold,
        links=context.links,
        base=context.base,
        rounds=context.rounds,
        contenders=context.contenders,
        codec=share_codec(BELIEFS, context.rule),
        trigger=context.rule.trigger,
    )


def alone_in_batch(context: BatchContext) -> "BatchedRule":
    """The matrix form of the rule that fuses nothing."""
    alone = HoldPolicy(lambda base, ages, _inverse_volume, _cycles: hold.alone(base, ages), False)
    return beliefs_in_batch(MOMENTS, context._replace(rule=context.rule._replace(hold=alone)))


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


CI = once(BELIEFS, partial(averaging, INFORMATION), partial(beliefs_in_batch, INFORMATION))
SHARP_CI = once(BELIEFS, partial(averaging, SharpIntersection()))
TRIMMED_CI = once(BELIEFS, trimmed, check=_require_honest_majorities, consistent=False)
WAC = once(BELIEFS, partial(averaging, MOMENTS), partial(beliefs_in_batch, MOMENTS))
LOCAL = once(BELIEFS, partial(averaging, Directly(keep_own)), alone_in_batch, weighted=False)
