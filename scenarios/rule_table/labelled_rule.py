"""The rule `labelled` at one node and at all nodes of many runs."""

from functools import lru_cache
from typing import Any

from concord.filters.filter import Filter
from concord.nodes.estimator import AnyEstimator
from concord.nodes.lanes.labelled_check import BatchedSelfChecked, BatchedSmoothing
from concord.nodes.lanes.network import BatchedRule
from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.labelled.checked import SelfCheckedFlooding, SmoothingFlooding
from concord.nodes.rules.labelled.frame import LabelledFrameCodec
from concord.nodes.rules.labelled.kept_steps import KeptSteps
from concord.nodes.rules.labelled.window_filter import FilteredPlace, WindowFilter
from concord.nodes.rules.local_filter import Model, SensorGroup
from concord.scenarios.node_context import BatchContext, Everybody, NodeContext
from concord.scenarios.rule_table.labelled import (
    check_labelled,
    choice_of,
    flooding_of,
    frame_codec,
    gates_of,
    largest_share,
    without_arrays,
)
from concord.scenarios.rule_table.rule import Rule
from concord.scenarios.scenario import Scenario

# How many steps a node may be ahead of another in lockstep.
_LEAD_STEPS = 4


def node_parts(window: type[WindowFilter], context: NodeContext) -> dict[str, Any]:
    """The arguments of a node's flooding whose windows are filtered so."""
    assert context.everybody is not None, "a node of this rule is told of all nodes"
    everybody, neighbours = context.everybody(), context.rule.neighbours
    frames = frame_codec(everybody, neighbours, context.rule.states)
    return dict(
        node=context.node,
        neighbours=neighbours,
        prior=context.prior,
        own=() if context.sensor is None else (SensorGroup(slice(None), context.sensor),),
        filter=_window_filter(window, everybody, frames, context.model, context.filter),
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


def batch_parts(window: type[WindowFilter], context: BatchContext) -> dict[str, Any]:
    """The same of all nodes of many runs, where `without_arrays` has nothing to name."""
    everybody, filters = context.everybody(), context.filters
    frames = frame_codec(everybody, context.rule.neighbours, context.rule.states)
    return dict(
        own=everybody.groups,
        filter=_window_filter(window, everybody, frames, filters.model, filters.filter),
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


def _window_filter(
    window: type[WindowFilter],
    everybody: Everybody,
    frames: LabelledFrameCodec,
    model: Model,
    filter: Filter,
) -> WindowFilter:
    sensors = AllSensors(everybody.groups, len(everybody.sensors), everybody.readings_shape)
    silence_fits = flooding_of(everybody.scenario).withhold_below > 0
    return window(
        model,
        filter,
        sensors,
        frames.codecs,
        silence_fits,
        everybody.late_steps,
        _kept_steps(everybody.scenario, window, frames.window_steps),
    )


@lru_cache(maxsize=2)
def _kept_steps(
    _scenario: Scenario, _window: type[WindowFilter], steps: int
) -> KeptSteps[FilteredPlace]:
    """Filtered steps that nodes of one scenario share: model, filter and sensors are equal."""
    return KeptSteps(steps + _LEAD_STEPS)


def _at_node(context: NodeContext) -> AnyEstimator:
    assert context.everybody is not None, "a node of this rule is told of all nodes"
    smooth_steps = flooding_of(context.everybody().scenario).smooth_steps
    parts = node_parts(WindowFilter, context)
    if smooth_steps:
        return SmoothingFlooding(**parts, smooth_steps=smooth_steps)
    return SelfCheckedFlooding(**parts)


def _in_batch(context: BatchContext) -> BatchedRule:
    smooth_steps = flooding_of(context.everybody().scenario).smooth_steps
    parts = batch_parts(WindowFilter, context)
    if smooth_steps:
        return BatchedSmoothing(**parts, smooth_steps=smooth_steps)
    return BatchedSelfChecked(**parts)


LABELLED = Rule(
    None,
    _at_node,
    _in_batch,
    check=check_labelled,
    lacking=without_arrays,
    weighted=False,
    share_bytes=largest_share,
)
