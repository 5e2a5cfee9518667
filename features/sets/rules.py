"""The rules of sets: how their estimators are built, and what frames them."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from concord.features.sets.filters.joint_noise import joined
from concord.features.sets.set_membership import (
    BoundedModel,
    BoundedSensor,
    SetAtNode,
    SetMembership,
    predict_sets,
    readings_of,
    take_readings,
)
from concord.features.sets.set_shapes import Ellipsoids, Shape, Zonotopes, set_form
from concord.features.sets.window_sets import WindowSets
from concord.filters.fusion.packed import packed_length
from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import EarlierBelief
from concord.nodes.lanes.labelled import BatchedFlooding
from concord.nodes.rules.labelled.flooding import LabelledFlooding
from concord.nodes.rules.lane_rule import LocalStep
from concord.nodes.rules.local_filter import LocalFilters, Model
from concord.scenarios.catalogue import definition_of
from concord.scenarios.filter_table.filters import build_filter
from concord.scenarios.node_context import RuleContext
from concord.scenarios.rule_table.labelled import check_labelled, largest_share, without_arrays
from concord.scenarios.rule_table.labelled_rule import batch_parts, node_parts
from concord.scenarios.rule_table.rule import Rule, ShareKind, at_node, in_batch
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    from concord.topology.weights import Weights

MakeShape = Callable[[int, str], Shape[Any]]


def set_membership(make: MakeShape, context: RuleContext) -> SetMembership[Any]:
    """For nodes that keep sets of a shape."""
    shape = make(context.states, context.number)
    return SetMembership(shape, context.hold.carried, context.trigger, context.contends)


def check_bounded(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    """Refuse a plant without bounds.

    Raises:
        ValueError: naming what is in the way, and the cure.
    """
    _bounded_model(definition_of(scenario).model(scenario), scenario)


def check_labelled_sets(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    """Refuse a plant without bounds, and as `check_labelled`."""
    check_bounded(scenario, neighbours, weights)
    check_labelled(scenario, neighbours, weights)


def baseline_filter(
    make: MakeShape,
    setup: Setup,
    nodes: Sequence[int],
    readings: np.ndarray,
    control: np.ndarray | None,
) -> Gaussian:
    """One set that is cut with the readings (steps, N, r, d) of these nodes, after every step."""
    definition = definition_of(setup.scenario)
    model = definition.model(setup.scenario)
    filters = LocalFilters(model, (), build_filter(setup.scenario.filter, len(setup.prior_mean)))
    sensors = [(node, definition.sensor(setup.scenario, node)) for node in nodes]
    shape = make(len(setup.prior_mean), "<f8")
    own = shape.containing(Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov)))
    joint, bounds = None, []
    for step, delivered in enumerate(readings):
        driven = None if control is None or step == 0 else control[step]
        if step > 0:
            now = LocalStep(filters, delivered[0], driven, step)
            own = predict_sets(shape, own, now, joint)
        seen = joined(
            [
                readings_of(cast(BoundedSensor, sensor), delivered[node], step)
                for node, sensor in sensors
                if sensor is not None
            ]
        )
        motion = cast(BoundedModel, model).motion(step)
        own, joint, _ = take_readings(shape, own, seen, motion)
        bounds.append(shape.bounds(own))
    return Gaussian(np.array([b.mean for b in bounds]), np.array([b.cov for b in bounds]))


def set_at_step(earlier: EarlierBelief, step: int, model: Model) -> Gaussian:
    """Carry a belief, which is a set, to a step under all noise within its bound.

    It holds the truth where one control drove all steps between, or none.
    """
    if earlier.step == step:
        return earlier.belief
    bounded, shape = cast(BoundedModel, model), Ellipsoids(len(earlier.belief.mean))
    kept = shape.containing(earlier.belief)
    for number in range(earlier.step, step):
        moved = bounded.transition(kept.centre, earlier.control, number)
        kept = shape.moved(kept, moved, *bounded.motion(number))
    return shape.bounds(kept)


def _bounded_model(model: object, scenario: Scenario | None = None) -> BoundedModel:
    if not isinstance(model, BoundedModel):
        what = "this rule" if scenario is None else f"rule {scenario.rule.name} on {scenario.name}"
        raise ValueError(
            f"{what}: its noise has no bound, and a set can hold the truth only of a plant whose "
            "noise has one; use --scenario liu2021-network, or a Gaussian rule such as ci"
        )
    return model


def _of_sets(make: MakeShape, share: ShareKind) -> Rule:
    build = partial(set_membership, make)
    return Rule(
        share,
        partial(at_node, SetAtNode, build, share),
        partial(in_batch, build, share),
        check=check_bounded,
        set_at_step=set_at_step,
        baseline_filter=partial(baseline_filter, make),
        weighted=False,
    )


ELLIPSOIDS = ShareKind(
    "belief",
    lambda states, _: packed_length(states),
    {"<u2": lambda states, _: set_form(states)},
)
ZONOTOPES = ShareKind("share", lambda states, _: states + states**2)
ELLIPSOID = _of_sets(Ellipsoids, ELLIPSOIDS)
ZONOTOPE = _of_sets(Zonotopes, ZONOTOPES)
LABELLED_ELLIPSOID = Rule(
    None,
    lambda context: LabelledFlooding(**node_parts(WindowSets, context)),
    lambda context: BatchedFlooding(**batch_parts(WindowSets, context)),
    check=check_labelled_sets,
    set_at_step=set_at_step,
    baseline_filter=partial(baseline_filter, Ellipsoids),
    lacking=without_arrays,
    weighted=False,
    share_bytes=largest_share,
)
