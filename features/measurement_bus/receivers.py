"""Receivers of a measurement bus by the filter that a scenario names."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.features.measurement_bus.cyclewise_receiver import (
    CutCycle,
    CyclewiseReceiver,
    augmented_cycle,
    conditioned_cycle,
)
from concord.features.measurement_bus.gaussian_receiver import GaussianReceiver, System
from concord.features.measurement_bus.measurement_bus import LosingBids, WeightsAt
from concord.features.measurement_bus.reception import Receiver
from concord.features.measurement_bus.stochastic_ukf import (
    RECOMMENDED,
    MeasurementFilter,
    on_fresh_rows,
)
from concord.features.sets.constrained_sets import ConstrainedZonotopes
from concord.features.sets.filters.closed_form import closed_form_step
from concord.features.sets.filters.constrained_zonotope import constrained_step
from concord.features.sets.filters.lifted_cycle import LinearBoundedSystem
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.features.sets.filters.tight_estimator import conditioned
from concord.features.sets.filters.zonotope_filter import zonotope_step
from concord.features.sets.set_receivers import MeasuredSets, StepwiseReceiver, without_gap
from concord.features.sets.set_shapes import Ellipsoids, Zonotopes
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule
from concord.scenarios.filters import build_filter
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.types.buses import SensorSlots
from concord.scenarios.types.filters import (
    ConstrainedReceiver,
    EllipsoidReceiver,
    FilterBase,
    InteractingMultipleModels,
    NoiseLearningFilter,
    PrintedFilter,
    RecommendedFilter,
    RepairedFilter,
    SetFilter,
    UserFilter,
    ZonotopeReceiver,
)
from concord.scenarios.types.rules import Reception
from concord.scenarios.user.values import ValueSource, value_of


class ReceiverParts(NamedTuple):
    """Everything that a receiver is built from.

    Attributes:
        system, points: of Gaussian receivers.
        bounded: the plant with bounded noise, for sets.
        schedule, weights: of the bus, by step.
        static: l, where some sensors own a slot each and the others contend for one; else None.
        held_half_width: of the held values at first, in the ellipsoid of the paper.
        prior: mean and covariance, or shape matrix, at step 0.
        held: (m,), values held at first.
        losing_bids: as in `MeasuredSets`.
    """

    system: System
    points: SigmaPointRule
    bounded: LinearBoundedSystem | None
    schedule: Schedule
    weights: WeightsAt
    static: int | None
    held_half_width: float
    prior: Gaussian
    held: np.ndarray
    losing_bids: LosingBids | None


def _cyclewise(choice: EllipsoidReceiver) -> tuple[CutCycle, bool]:
    """How an ellipsoid is cut, and whether its state is augmented by held values."""
    if choice.method == "tight":
        return partial(conditioned_cycle, choice.accuracy), False
    paper = partial(optimal_step, accuracy=choice.accuracy)
    step = paper if choice.method == "paper" else closed_form_step
    return partial(augmented_cycle, step), True


# Filters as printed live with their paper; no folder but the papers' own imports them.
_AS_PRINTED = "concord.papers.meng2025.filter_as_printed"


def _gaussian(choice: FilterBase, parts: ReceiverParts) -> Receiver:
    filter = build_filter(choice, len(parts.prior.mean), parts.points)
    fresh = on_fresh_rows(lambda _: filter)
    return GaussianReceiver(parts.system, fresh, parts.points, parts.prior)


def _recommended(choice: FilterBase, parts: ReceiverParts) -> Receiver:
    return GaussianReceiver(parts.system, RECOMMENDED, parts.points, parts.prior)


def _printed(name: str, choice: FilterBase, parts: ReceiverParts) -> Receiver:
    filter = value_of(ValueSource(f"{_AS_PRINTED}:{name}"))
    return GaussianReceiver(parts.system, filter, parts.points, parts.prior)


def _of_user(choice: UserFilter, parts: ReceiverParts) -> Receiver:
    value = value_of(choice.where)
    if isinstance(value, MeasurementFilter):
        return GaussianReceiver(parts.system, value, parts.points, parts.prior)
    return _gaussian(choice, parts)


def _measured(choice: SetFilter, parts: ReceiverParts) -> MeasuredSets:
    assert parts.bounded is not None, "check refuses plants without bounds"
    losing_bids = parts.losing_bids if choice.losers else None
    return MeasuredSets(
        parts.bounded, parts.schedule, parts.weights, parts.prior, parts.held, losing_bids
    )


def _ellipsoid(choice: EllipsoidReceiver, parts: ReceiverParts) -> Receiver:
    measured = _measured(choice, parts)
    if choice.method == "fast-rate" or parts.static is None:
        step = partial(conditioned, accuracy=choice.accuracy)
        return StepwiseReceiver(measured, Ellipsoids(len(parts.prior.mean)), step)
    cut, is_augmented = _cyclewise(choice)
    width = parts.held_half_width if is_augmented else None
    return CyclewiseReceiver(measured, parts.static, cut, width)


def _zonotope(choice: ZonotopeReceiver, parts: ReceiverParts) -> Receiver:
    shape = Zonotopes(len(parts.prior.mean), generators=choice.generators)
    step = partial(zonotope_step, generators=choice.generators)
    return StepwiseReceiver(_measured(choice, parts), shape, without_gap(step))


def _constrained(choice: ConstrainedReceiver, parts: ReceiverParts) -> Receiver:
    shape = ConstrainedZonotopes(len(parts.prior.mean))
    step = partial(constrained_step, generators=choice.generators, constraints=choice.constraints)
    return StepwiseReceiver(_measured(choice, parts), shape, without_gap(step))


_RECEIVERS: dict[type[FilterBase], Callable[[Any, ReceiverParts], Receiver]] = {
    RecommendedFilter: _recommended,
    PrintedFilter: partial(_printed, "PAPER_LITERAL"),
    RepairedFilter: partial(_printed, "PAPER_LITERAL_R"),
    EllipsoidReceiver: _ellipsoid,
    ZonotopeReceiver: _zonotope,
    ConstrainedReceiver: _constrained,
    UserFilter: _of_user,
}


def build_receiver(choice: FilterBase, parts: ReceiverParts) -> Receiver:
    """The receiver of a filter; filters of the nodes take what is sent and nothing else.

    Raises:
        ValueError: a file that has no such filter.
    """
    return _RECEIVERS.get(type(choice), _gaussian)(choice, parts)


def check_receiver(scenario: Scenario, is_bounded: bool) -> None:
    """Refuse a receiver of sets without bounds, and one on a bus that it cannot use.

    Raises:
        ValueError: naming the receiver, what is in its way, and the cure.
    """
    choice, rule = scenario.filter, scenario.rule
    if isinstance(choice, NoiseLearningFilter):
        raise ValueError(
            f"--filter {choice.name}: it learns the noise of a node's own sensors, and the "
            "receiver of a measurement bus has none; use ukf or recommended"
        )
    if isinstance(choice, InteractingMultipleModels):
        raise ValueError(
            f"--filter {choice.name}: its models are a straight course and a turn, and the "
            "receiver of a measurement bus has the one of its plant; use ukf or recommended"
        )
    if not isinstance(choice, SetFilter):
        return
    assert isinstance(rule, Reception), "the caller has looked"
    if not is_bounded:
        raise ValueError(
            f"--filter {choice.name}: the noise of {scenario.name} has no bound, and a set can "
            "hold the truth only of a plant whose noise has one; use a BoundedPlant, or a Gaussian "
            "filter such as recommended"
        )
    why = "a set takes what was received for exact"
    require(rule.number == "float64", "number", rule.number, f"float64: {why}")
    require(rule.hold.name == "zero-order", "hold", rule.hold.name, "zero-order: sets hold values")
    if isinstance(choice, EllipsoidReceiver) and choice.method == "fast":
        usual = choice.accuracy == EllipsoidReceiver().accuracy
        require(usual, "accuracy", choice.accuracy, "left out with --method fast, a closed form")
    if isinstance(choice, EllipsoidReceiver) and choice.method != "fast-rate":
        needed = f"flexray: --method {choice.method} works by communication cycles; use fast-rate"
        schedule = scenario.bus.schedule
        require(isinstance(schedule, SensorSlots), "schedule", schedule.name, needed)
