"""A fusion rule as the table of rules has it."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.turns import Angles
from concord.nodes.estimator import AnyEstimator, EarlierBelief
from concord.nodes.rules.local_filter import Model
from concord.scenarios.node_context import BatchContext, NodeContext
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    from concord.nodes.lanes.network import BatchedRule
    from concord.topology.weights import Weights

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from concord.filters.fusion.packed import packed_length
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.lane_rule import LaneRule, Place
from concord.nodes.share_forms import (
    AboutOrigin,
    InformationPair,
    ShareForm,
    SingleBelief,
    SingleHybrid,
    SingleNovelty,
    StackedBelief,
    TwoByteBelief,
    TwoByteHybrid,
)
from concord.nodes.vector_codec import VectorCodec
from concord.scenarios.node_context import RuleContext

if TYPE_CHECKING:
    from concord.nodes.lanes.network import BatchedRule


FormOf = Callable[[int, int], ShareForm]
"""The form for so many states and nodes."""


class ShareKind(NamedTuple):
    """A kind of share.

    Attributes:
        what: its name in reports of shares that cannot be used.
        length: how many numbers are in a share, for so many states and nodes.
        forms: its form by type code; a float type without one is written number by number.
        has_mean: it begins with the mean of the states, which a form writes about their origin.
            Other rules compute with states about it.
        with_angles: the kind where states are angles, if that is another one.
    """

    what: str
    length: Callable[[int, int], int]
    forms: Mapping[str, FormOf] = {}
    has_mean: bool = False
    with_angles: "ShareKind | None" = None

    def of(self, angles: Angles) -> "ShareKind":
        """The kind for a plant with these angles."""
        return self.with_angles or self if angles else self

    def codec(
        self,
        number: str,
        states: int,
        nodes: int,
        models: int = 1,
        origin: np.ndarray | None = None,
    ) -> VectorCodec:
        """How a share is written; of beliefs of several models, all that is not known of it."""
        if models > 1:
            stacked = StackedBelief(states, models, number == "<f4")
            return VectorCodec(packed_length(stacked.size), number, self.what, stacked)
        form = self.forms.get(number)
        made = None if form is None else form(states, nodes)
        if made is not None and self.has_mean and origin is not None:
            made = AboutOrigin(made, tuple(origin.tolist()))
        return VectorCodec(self.length(states, nodes), number, self.what, made)

    def has(self, number: str) -> bool:
        """Whether shares of this kind can be written so."""
        return np.dtype(number).kind == "f" or number in self.forms


BELIEFS = ShareKind(
    "belief",
    lambda states, _: packed_length(states),
    {"<f4": lambda states, _: SingleBelief(states), "<u2": lambda states, _: TwoByteBelief(states)},
    has_mean=True,
)
INFORMATION_PAIRS = ShareKind(
    "share",
    lambda states, _: packed_length(states),
    {
        "<f4": lambda states, _: InformationPair(SingleBelief(states)),
        "<u2": lambda states, _: InformationPair(TwoByteBelief(states)),
    },
)
HYBRID = ShareKind(
    "share",
    lambda states, nodes: 2 * packed_length(states) + nodes,
    {"<f4": SingleHybrid, "<u2": TwoByteHybrid},
)
_SINGLE_NOVELTY: Mapping[str, FormOf] = {"<f4": lambda states, _: SingleNovelty(states)}
NOVELTIES_AND_MEANS = ShareKind(
    "share",
    lambda states, _: packed_length(states) + states,
    {"<f4": lambda states, _: SingleNovelty(states, states)},
)
# Without the mean of its prior, the turn to which a novelty belongs is unknown.
NOVELTIES = ShareKind(
    "share",
    lambda states, _: packed_length(states),
    _SINGLE_NOVELTY,
    with_angles=NOVELTIES_AND_MEANS,
)


class Rule(NamedTuple):
    """A fusion rule of the network.

    Attributes:
        share: what its shares are; None where `share_bytes` tells their length.
        estimator: builds that of one node.
        batched: builds the rule at all nodes of many runs.
        check: refuses scenario, neighbours of each node and weights (N, N) that it cannot do with.
        set_at_step: (set of an earlier step, step, model) -> the set of that step. Given for a rule
            whose covariances are shape matrices of ellipsoids that hold the truth for certain.
        baseline_filter: (setup, nodes, readings (steps, N, r, d), control (steps, p) or None) ->
            beliefs (steps,) of one filter that takes the readings of these nodes; None for the
            Gaussian filter of the scenario.
        lacking: what of a scenario the batched rule does not have; None if it has all.
        consistent: it claims that covariances cover the errors, or that sets hold the truth.
        weighted: the network's consensus weights are used.
        share_bytes: (scenario, states) -> length of the longest share of a rule without `share`.
        plain: builds the batched rule as it is at a node, without a faster form; None of a rule
            that is not written once.
    """

    share: ShareKind | None
    estimator: Callable[[NodeContext], AnyEstimator]
    batched: Callable[[BatchContext], "BatchedRule"]
    check: "Callable[[Scenario, Sequence[Sequence[int]], Weights], None] | None" = None
    set_at_step: Callable[[EarlierBelief, int, Model], Gaussian] | None = None
    baseline_filter: (
        Callable[[Setup, Sequence[int], np.ndarray, np.ndarray | None], Gaussian] | None
    ) = None
    lacking: Callable[[Scenario], str | None] = lambda _: None
    weighted: bool = True
    consistent: bool = True
    share_bytes: Callable[[Scenario, int], int] | None = None
    plain: Callable[[BatchContext], "BatchedRule"] | None = None

    @property
    def set_valued(self) -> bool:
        """Whether beliefs are sets that hold the truth for certain."""
        return self.set_at_step is not None

    @property
    def shares_beliefs(self) -> bool:
        """Whether a share is a mean and a covariance."""
        return self.share is BELIEFS


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
    plain = partial(in_batch, build, share)

    def at_all(context: BatchContext) -> "BatchedRule":
        # Where states are angles, each receiver has turns of its own, which no matrix averages.
        return plain(context) if batched is None or context.rule.angles else batched(context)

    return Rule(share, at_one, at_all, plain=plain, **properties)


def share_codec(share: ShareKind, context: RuleContext) -> VectorCodec:
    """How shares of a kind are written."""
    kind, nodes = share.of(context.angles), len(context.neighbours)
    return kind.codec(context.number, context.states, nodes, context.models, context.origin)


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
