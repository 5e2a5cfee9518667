"""How a rule is built from a scenario: once, and then at one node or at all nodes of many runs."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.lane_rule import LaneRule, Place
from concord.nodes.vector_codec import VectorCodec
from concord.scenarios.node_context import BatchContext, NodeContext, RuleContext
from concord.scenarios.rule_table.rule import Rule
from concord.scenarios.rule_table.share_kinds import ShareKind

if TYPE_CHECKING:
    from concord.nodes.lanes.network import BatchedRule

AnyRule = LaneRule[Any, Any, Any]
BuildRule = Callable[[RuleContext], AnyRule]
NodeRule = TypeVar("NodeRule", bound=AtNode)


def once(
    share: ShareKind,
    build: BuildRule,
    batched: Callable[[BatchContext], "BatchedRule"] | None = None,
    **properties: Any,
) -> Rule:
    """A rule that is written once: `build` serves one node and all nodes of many runs.

    `batched` is a faster form for many runs.
    """
    at_one = partial(at_node, AtNode, build, share)
    at_all = batched or partial(in_batch, build, share)
    return Rule(share, at_one, at_all, **properties)


def share_codec(share: ShareKind, context: RuleContext) -> VectorCodec:
    """How shares of a kind are written."""
    return share.codec(context.number, context.states, len(context.neighbours), context.models)


def at_node(
    kind: type[NodeRule], build: BuildRule, share: ShareKind, context: NodeContext
) -> NodeRule:
    """The estimator of a rule whose shares are vectors of numbers."""
    rule = build(context.rule)
    place = Place(np.array(context.node), context.weights)
    codec = share_codec(share, context.rule)
    return kind(rule, place, context.model, context.sensor, context.prior, context.filter, codec)


def in_batch(build: BuildRule, share: ShareKind, context: BatchContext) -> "BatchedRule":
    """A rule whose shares are vectors of numbers."""
    # Only here: a node computes without arrays of nodes.
    from concord.nodes.lanes.batch import InBatch

    rule = build(context.rule)
    codec = share_codec(share, context.rule)
    return InBatch(rule, context.filters, context.links, context.base, codec)


def averages_in_batch(build: BuildRule, share: ShareKind, context: BatchContext) -> "BatchedRule":
    """The matrix form of a rule whose rounds are averages."""
    # Only here: a node computes without arrays of nodes.
    from concord.nodes.lanes.batch import AveragesInBatch

    rule = build(context.rule)
    codec = share_codec(share, context.rule)
    return AveragesInBatch(rule, context.filters, context.links, context.base, codec)
