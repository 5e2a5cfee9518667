"""The set-membership rules: how their estimators are built, and what frames them."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from concord.features.sets.filters.joint_noise import joined
from concord.features.sets.set_membership import (
    BoundedModel,
    BoundedSensor,
    SetMembership,
    predict_sets,
    readings_of,
    take_readings,
)
from concord.features.sets.set_shapes import Shape
from concord.filters.gaussian import Gaussian
from concord.nodes.rules.lane_rule import LocalStep
from concord.nodes.rules.local_filter import LocalFilters
from concord.scenarios.catalogue import definition_of
from concord.scenarios.filters import build_filter
from concord.scenarios.labelled import check_labelled
from concord.scenarios.node_context import RuleContext
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


def _bounded_model(model: object, scenario: Scenario | None = None) -> BoundedModel:
    if not isinstance(model, BoundedModel):
        what = "this rule" if scenario is None else f"rule {scenario.rule.name} on {scenario.name}"
        raise ValueError(
            f"{what}: its noise has no bound, and a set can hold the truth only of a plant whose "
            "noise has one; use --scenario liu2021-network, or a Gaussian rule such as ci"
        )
    return model
