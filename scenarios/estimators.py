"""How a rule is built from a scenario: once, and then at one node or at all nodes of many runs."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import numpy as np

from concord.features.sets.set_membership import SetAtNode
from concord.features.sets.window_sets import WindowSets
from concord.filters.filter import Filter
from concord.filters.fusion import (
    diffusion,
    hold,
    hybrid_consensus,
    information_weighted,
    kalman_consensus,
)
from concord.filters.fusion.averaging import MOMENTS, Averaged, Averaging, Directly
from concord.filters.fusion.trimmed import trimmed_intersection
from concord.filters.gaussian import Gaussian
from concord.filters.interacting_models import stacked_size
from concord.nodes.estimator import AnyEstimator
from concord.nodes.lanes.batch import AveragesInBatch, InBatch
from concord.nodes.lanes.beliefs import BatchedBeliefs
from concord.nodes.lanes.labelled import BatchedFlooding
from concord.nodes.lanes.labelled_check import BatchedSelfChecked
from concord.nodes.lanes.labelled_past import BatchedSmoothing
from concord.nodes.lanes.network import BatchedRule
from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.belief_consensus import BeliefConsensus, HoldPolicy
from concord.nodes.rules.fresh_consensus import FreshConsensus
from concord.nodes.rules.information_rounds import InformationRounds
from concord.nodes.rules.labelled.checked import SelfCheckedFlooding
from concord.nodes.rules.labelled.flooding import LabelledFlooding
from concord.nodes.rules.labelled.frame import LabelledFrameCodec
from concord.nodes.rules.labelled.smoothing import SmoothingFlooding
from concord.nodes.rules.labelled.window_filter import WindowFilter
from concord.nodes.rules.lane_rule import LaneRule, Place
from concord.nodes.rules.local_filter import Model, SensorGroup
from concord.nodes.rules.novelty_rounds import NoveltyRounds
from concord.nodes.vector_codec import VectorCodec
from concord.scenarios.labelled import choice_of, flooding_of, frame_codec, gates_of
from concord.scenarios.node_context import BatchContext, Everybody, NodeContext, RuleContext
from concord.scenarios.share_kinds import BELIEFS, ShareKind
from concord.scenarios.types.rules import EllipsoidFlooding, TrimmedCovarianceIntersection

AnyRule = LaneRule[Any, Any, Any]
BuildRule = Callable[[RuleContext], AnyRule]
NodeRule = TypeVar("NodeRule", bound=AtNode)


# --- a rule, once --------------------------------------------------------------------------------


def averaging(rule: Averaged, context: RuleContext) -> AnyRule:
    """For rules that average beliefs, fresh ones and held ones."""
    size = stacked_size(context.states, context.models)
    return BeliefConsensus(rule, context.hold, size, context.trigger, context.contends)


def trimmed(context: RuleContext) -> AnyRule:
    """For covariance intersection among liars: their own claims give no weight."""
    rule = context.rule
    assert isinstance(rule, TrimmedCovarianceIntersection), "the table of rules chose it"
    return averaging(Directly(partial(trimmed_intersection, liars=rule.liars)), context)


def hybrid(gain: hybrid_consensus.Gain, context: RuleContext) -> AnyRule:
    """For consensus on prior and novelty."""
    rows = np.eye(len(context.neighbours))

    def begin(node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        return hybrid_consensus.begin(prior, posterior, rows[node])

    rule = InformationRounds(
        begin,
        partial(hybrid_consensus.from_information, states=context.states, gain=gain),
        partial(hybrid_consensus.sound, states=context.states),
    )
    return FreshConsensus(rule, context.trigger, context.contends)


def weighted_information(context: RuleContext) -> AnyRule:
    """For information-weighted consensus."""
    nodes = len(context.neighbours)
    rule = InformationRounds(
        lambda _, prior, posterior: information_weighted.begin(prior, posterior, nodes),
        partial(information_weighted.from_information, nodes=nodes),
        information_weighted.sound,
    )
    return FreshConsensus(rule, context.trigger, context.contends)


def diffused(context: RuleContext) -> AnyRule:
    """For diffusion; on a complete graph with one round it is the centralised filter."""
    rule = NoveltyRounds(diffusion.begin, diffusion.incremental, diffusion.combine)
    return FreshConsensus(rule, context.trigger, context.contends)


def pulled(context: RuleContext) -> AnyRule:
    """For the Kalman-consensus filter."""
    rate = kalman_consensus.largest_rate(max(len(heard) for heard in context.neighbours))
    rule = NoveltyRounds(
        kalman_consensus.begin,
        partial(kalman_consensus.correct, rate=rate),
        lambda means, _: kalman_consensus.average(means, rate),
    )
    return FreshConsensus(rule, context.trigger, context.contends)


def _codec(share: ShareKind, context: RuleContext) -> VectorCodec:
    return share.codec(context.number, context.states, len(context.neighbours), context.models)


# --- at one node ---------------------------------------------------------------------------------


def at_node(build: BuildRule, share: ShareKind, context: NodeContext) -> AtNode[Any, Any, Any]:
    """The estimator of a rule whose shares are vectors of numbers."""
    return _at_node(AtNode, build, share, context)


def set_at_node(build: BuildRule, share: ShareKind, context: NodeContext) -> SetAtNode[Any]:
    """The same of a set-membership rule."""
    return _at_node(SetAtNode, build, share, context)


def _at_node(
    kind: type[NodeRule], build: BuildRule, share: ShareKind, context: NodeContext
) -> NodeRule:
    rule = build(context.rule)
    place = Place(np.array(context.node), context.weights)
    codec = _codec(share, context.rule)
    return kind(rule, place, context.model, context.sensor, context.prior, context.filter, codec)


def flooding(context: NodeContext) -> AnyEstimator:
    """The estimator of labelled measurements."""
    assert context.everybody is not None, "a node of this rule is told of all nodes"
    everybody, neighbours = context.everybody(), context.rule.neighbours
    frames = frame_codec(everybody, neighbours, context.rule.states)
    usual: dict[str, Any] = dict(
        node=context.node,
        neighbours=neighbours,
        prior=context.prior,
        own=() if context.sensor is None else (SensorGroup(slice(None), context.sensor),),
        filter=_window_filter(everybody, frames, context.model, context.filter),
        frames=frames,
        choice=choice_of(everybody.scenario, frames),
        schedule=everybody.schedule,
        rounds=everybody.scenario.rounds,
        gates=gates_of(everybody.scenario, everybody.readings_shape[1]),
        withhold_below=flooding_of(everybody.scenario).withhold_below,
        first_step=context.beginning.step,
        first_cycle=context.beginning.cycle,
        joins=context.beginning.joins,
    )
    rule = flooding_of(everybody.scenario)
    if isinstance(rule, EllipsoidFlooding):
        return LabelledFlooding(**usual)
    if rule.smooth_steps:
        return SmoothingFlooding(**usual, smooth_steps=rule.smooth_steps)
    return SelfCheckedFlooding(**usual)


def _window_filter(
    everybody: Everybody, frames: LabelledFrameCodec, model: Model, filter: Filter
) -> WindowFilter:
    sensors = AllSensors(everybody.groups, len(everybody.sensors), everybody.readings_shape)
    rule = flooding_of(everybody.scenario)
    kind = WindowSets if isinstance(rule, EllipsoidFlooding) else WindowFilter
    silence_fits = rule.withhold_below > 0
    return kind(model, filter, sensors, frames.codecs, silence_fits, everybody.late_steps)


# --- at all nodes of many runs -------------------------------------------------------------------


def in_batch(build: BuildRule, share: ShareKind, context: BatchContext) -> BatchedRule:
    """A rule whose shares are vectors of numbers."""
    rule = build(context.rule)
    codec = _codec(share, context.rule)
    return InBatch(rule, context.filters, context.links, context.base, codec)


def averages_in_batch(build: BuildRule, share: ShareKind, context: BatchContext) -> BatchedRule:
    """The matrix form of a rule whose rounds are averages."""
    rule = build(context.rule)
    codec = _codec(share, context.rule)
    return AveragesInBatch(rule, context.filters, context.links, context.base, codec)


def alone_in_batch(context: BatchContext) -> BatchedRule:
    """The matrix form of the rule that fuses nothing."""
    alone = HoldPolicy(lambda base, ages, _inverse_volume, _cycles: hold.alone(base, ages), False)
    return beliefs_in_batch(MOMENTS, context._replace(rule=context.rule._replace(hold=alone)))


def beliefs_in_batch(rule: Averaging, context: BatchContext) -> BatchedRule:
    """The matrix form of rules that average beliefs."""
    return BatchedBeliefs(
        filters=context.filters,
        averaging=rule,
        hold=context.rule.hold,
        links=context.links,
        base=context.base,
        rounds=context.rounds,
        contenders=context.contenders,
        codec=_codec(BELIEFS, context.rule),
        trigger=context.rule.trigger,
    )


def flooding_in_batch(context: BatchContext) -> BatchedRule:
    """Labelled measurements, in scenarios of which `concord.scenarios.labelled.without_arrays` has
    nothing to name."""
    everybody, filters = context.everybody(), context.filters
    frames = frame_codec(everybody, context.rule.neighbours, context.rule.states)
    usual: dict[str, Any] = dict(
        own=everybody.groups,
        filter=_window_filter(everybody, frames, filters.model, filters.filter),
        frames=frames,
        choice=choice_of(everybody.scenario, frames),
        links=context.links,
        schedule=everybody.schedule,
        rounds=context.rounds,
        gates=gates_of(everybody.scenario, everybody.readings_shape[1]),
        withhold_below=flooding_of(everybody.scenario).withhold_below,
        first_step=context.beginning.step,
        first_cycle=context.beginning.cycle,
    )
    rule = flooding_of(everybody.scenario)
    if isinstance(rule, EllipsoidFlooding):
        return BatchedFlooding(**usual)
    if rule.smooth_steps:
        return BatchedSmoothing(**usual, smooth_steps=rule.smooth_steps)
    return BatchedSelfChecked(**usual)
