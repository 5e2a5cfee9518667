"""Receivers of a measurement bus that keep sets."""

from functools import partial

from concord.features.measurement_bus.options import Reception, SensorSlots
from concord.features.measurement_bus.receivers import ReceiverDefinition, ReceiverParts
from concord.features.measurement_bus.reception import Receiver
from concord.features.sets.cyclewise_receiver import (
    CutCycle,
    CyclewiseReceiver,
    augmented_cycle,
    conditioned_cycle,
)
from concord.features.sets.filters.closed_form import closed_form_step
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.features.sets.filters.tight_estimator import conditioned
from concord.features.sets.filters.zonotope_filter import zonotope_step
from concord.features.sets.options import EllipsoidReceiver, SetFilter, ZonotopeReceiver
from concord.features.sets.set_receivers import MeasuredSets, StepwiseReceiver, without_gap
from concord.features.sets.set_shapes import Ellipsoids, Zonotopes
from concord.scenarios.scenario import Scenario, require


def _cyclewise(choice: EllipsoidReceiver) -> tuple[CutCycle, bool]:
    """How an ellipsoid is cut, and whether its state is augmented by held values."""
    if choice.method == "tight":
        return partial(conditioned_cycle, choice.accuracy), False
    paper = partial(optimal_step, accuracy=choice.accuracy)
    step = paper if choice.method == "paper" else closed_form_step
    return partial(augmented_cycle, step), True


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


def _check(scenario: Scenario, is_bounded: bool) -> None:
    """Refuse a receiver of sets without bounds, and one on a bus that it cannot use.

    Raises:
        ValueError: naming the receiver, what is in its way, and the cure.
    """
    choice, rule = scenario.filter, scenario.rule
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


ELLIPSOID = ReceiverDefinition(_ellipsoid, _check, one_by_one=True)
ZONOTOPE = ReceiverDefinition(_zonotope, _check, one_by_one=True)
