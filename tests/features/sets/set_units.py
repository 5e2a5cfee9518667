"""A bounded plant on a measurement bus in other units, and the five set filters on both."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.filters import zonotope
from concord.features.sets.filters.bus_readings import (
    MeasuredPlant,
    augmented,
    cycle_evidence,
    step_evidence,
)
from concord.features.sets.filters.closed_form import closed_form_step
from concord.features.sets.filters.ellipsoid import Ellipsoid, half_widths, image
from concord.features.sets.filters.lifted_cycle import DeliveredValues
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.features.sets.filters.tight_estimator import conditioned_step
from concord.features.sets.filters.zonotope import Zonotope
from concord.features.sets.filters.zonotope_filter import zonotope_step


class Units(NamedTuple):
    """Lengths of the old units in new ones: of the states (n,) and of the outputs (m,)."""

    states: np.ndarray
    outputs: np.ndarray


class Widths(NamedTuple):
    """Centres and half-widths (T, R, n) of the last state in the set."""

    centre: np.ndarray
    half_widths: np.ndarray


def in_units(plant: MeasuredPlant, units: Units) -> MeasuredPlant:
    """Return the same plant: x' = T x, y' = S y, and weights that compare the same changes."""
    old, states, outputs = plant.system, units.states, units.outputs
    system = BoundedSystem(
        lambda k: states[:, None] * old.transition(k) / states,
        lambda k: states[:, None] * old.noise_input(k),
        lambda k: outputs[:, None] * old.output(k) / states,
        lambda k: outputs[:, None] * old.feedthrough(k),
        old.noise_shape,
    )
    contending = outputs[plant.static_outputs :]
    return MeasuredPlant(system, plant.static_outputs, lambda k: plant.weights(k) / contending**2)


def delivered_in(received: DeliveredValues, units: Units, static: int) -> DeliveredValues:
    """Return what the bus delivered, in the units of the outputs."""
    held = received.held * units.outputs[static:]
    return received._replace(values=received.values * units.outputs, held=held)


def _by_cycle(step, plant: MeasuredPlant, received: DeliveredValues, units: Units) -> Widths:
    lanes, n = received.values.shape[0], len(units.states)
    scales = np.concatenate(
        [np.tile(units.states, plant.length), units.outputs[plant.static_outputs :]]
    )
    kept, sets = _ball(scales, lanes), []
    for cycle in range(received.values.shape[-2]):
        kept = step(kept, augmented(plant, received, cycle), received.values[:, cycle]).after
        sets.append(kept)
    last = slice((plant.length - 1) * n, plant.length * n)
    return Widths(
        np.array([one.centre[:, last] for one in sets]),
        np.array([half_widths(one)[:, last] for one in sets]),
    )


def _tight(plant: MeasuredPlant, received: DeliveredValues, units: Units) -> Widths:
    n = len(units.states)
    last = np.eye(plant.length * n)[-n:]
    kept, sets = _ball(units.states, received.values.shape[0]), []
    for cycle in range(received.values.shape[-2]):
        kept = image(conditioned_step(kept, cycle_evidence(plant, received, cycle)), last)
        sets.append(kept)
    return Widths(
        np.array([one.centre for one in sets]), np.array([half_widths(one) for one in sets])
    )


def _fast_rate(plant: MeasuredPlant, received: DeliveredValues, units: Units) -> Widths:
    kept, sets = _ball(units.states, received.values.shape[0]), []
    for cycle in range(received.values.shape[-2]):
        for evidence in step_evidence(plant, received, cycle):
            kept = conditioned_step(kept, evidence)
            sets.append(kept)
    return Widths(
        np.array([one.centre for one in sets]), np.array([half_widths(one) for one in sets])
    )


def _zonotope(plant: MeasuredPlant, received: DeliveredValues, units: Units) -> Widths:
    kept, sets = Zonotope(*_ball(units.states, received.values.shape[0])), []
    for cycle in range(received.values.shape[-2]):
        for evidence in step_evidence(plant, received, cycle):
            kept = zonotope_step(kept, evidence, generators=2 * len(units.states) + 4)
            sets.append(kept)
    return Widths(
        np.array([one.centre for one in sets]),
        np.array([zonotope.half_widths(one) for one in sets]),
    )


def _ball(scales: np.ndarray, lanes: int) -> Ellipsoid:
    size = len(scales)
    return Ellipsoid(np.zeros((lanes, size)), np.broadcast_to(np.diag(scales), (lanes, size, size)))


METHODS: dict[str, Callable[[MeasuredPlant, DeliveredValues, Units], Widths]] = {
    "paper": lambda *run: _by_cycle(optimal_step, *run),
    "fast": lambda *run: _by_cycle(closed_form_step, *run),
    "tight": _tight,
    "fast-rate": _fast_rate,
    "zonotope": _zonotope,
}


def apart(method: str, plant: MeasuredPlant, received: DeliveredValues, units: Units) -> np.ndarray:
    """Return how far (R,) a method's sets in two systems of units are apart, at most.

    The differences of centres and half-widths, over the half-width and a hundredth of the first
    one, for a state that became known is as wide as its rounding; infinite where one lost its lane.
    """
    one = Units(np.ones(len(units.states)), np.ones(len(units.outputs)))
    old = METHODS[method](plant, received, one)
    new = METHODS[method](
        in_units(plant, units), delivered_in(received, units, plant.static_outputs), units
    )
    width = old.half_widths + 1e-2
    wider = np.abs(new.half_widths / units.states - old.half_widths) / width
    beside = np.abs(new.centre / units.states - old.centre) / width
    worst = np.maximum(wider, beside).max((0, 2))
    lost = np.isnan(old.half_widths).any((0, 2)), np.isnan(new.half_widths).any((0, 2))
    return np.where(lost[0] & lost[1], 0.0, np.where(lost[0] | lost[1], np.inf, worst))
