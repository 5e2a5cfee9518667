"""The set-membership rules: how their estimators are built, and what frames them."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from filters.gaussian import Gaussian
from nodes.estimator import Estimator
from nodes.messages import Array, Measured, to_wire
from nodes.set_membership import BoundedModel, BoundedSensor, SetMembership, carry, take_strips
from nodes.set_shapes import Ellipsoids, Shape, Zonotopes
from scenarios.catalogue import kind_of
from scenarios.estimators import Seat
from scenarios.scenario import Scenario

if TYPE_CHECKING:
    from scenarios.setup import Setup
    from topology.weights import Weights

MakeShape = Callable[[int, str], Shape]


def ellipsoids(seat: Seat) -> Estimator:
    """For nodes that keep ellipsoids."""
    return _estimator(Ellipsoids(len(seat.prior.mean), seat.number), seat)


def zonotopes(seat: Seat) -> Estimator:
    """For nodes that keep zonotopes."""
    return _estimator(Zonotopes(len(seat.prior.mean), seat.number), seat)


def _estimator(shape: Shape, seat: Seat) -> SetMembership:
    return SetMembership(
        model=_bounded_model(seat.model),
        sensor=_bounded_sensor(seat.sensor),
        prior=seat.prior,
        shape=shape,
        neighbours=len(seat.neighbours[seat.node]),
        carried=seat.hold.carried,
        trigger=seat.trigger,
    )


def check_bounded(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    """Refuse a plant without bounds, and sets that are not carried through it.

    Raises:
        ValueError: naming what is in the way, and the cure.
    """
    _bounded_model(kind_of(scenario.name).model(scenario), scenario)
    if scenario.hold == "raw":
        raise ValueError(
            f"--hold raw with rule {scenario.rule}: a set that is not carried through the plant "
            "does not hold the truth of a later step; use --hold predict, or drop"
        )


def listen(
    make: MakeShape, setup: "Setup", nodes: Sequence[int], readings: Array, control: Array | None
) -> Gaussian:
    """One set that is cut with the readings (steps, N, r, d) of these nodes, after every step."""
    kind = kind_of(setup.scenario.name)
    model = _bounded_model(kind.model(setup.scenario))
    sensors = {i: _bounded_sensor(kind.sensor(setup.scenario, i)) for i in nodes}
    shape = make(len(setup.prior_mean), "<f8")
    own = shape.around(Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov)))
    bounds = []
    for step, delivered in enumerate(readings):
        driven = None if control is None or step == 0 else control[step].tolist()
        for place, (node, sensor) in enumerate(sensors.items()):
            measured = Measured(node, step, to_wire(delivered[node]), driven)
            if step > 0 and place == 0:
                own = carry(shape, [own], measured, model)[0]
            own, _ = take_strips(shape, own, measured, sensor)
        bounds.append(shape.bounds(own))
    return Gaussian(np.array([b.mean for b in bounds]), np.array([b.cov for b in bounds]))


def _bounded_model(model: object, scenario: Scenario | None = None) -> BoundedModel:
    if not isinstance(model, BoundedModel):
        what = "this rule" if scenario is None else f"rule {scenario.rule} on {scenario.name}"
        raise ValueError(
            f"{what}: its noise has no bound, and a set can hold the truth only of a plant whose "
            "noise has one; use --scenario liu2021-network, or a Gaussian rule such as ci"
        )
    return model


def _bounded_sensor(sensor: object) -> BoundedSensor | None:
    if sensor is not None and not isinstance(sensor, BoundedSensor):
        raise ValueError("this rule needs sensors whose noise has a bound")
    return sensor
