"""Noise sequences of the set-membership example, and every estimator on all of them at once."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, cast

import numpy as np

from concord.features.measurement_bus.measurement_bus import MeasurementBus
from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.delivered import bus_of_outputs, delivered
from concord.features.sets.filters import histories, zonotope
from concord.features.sets.filters.bus_readings import MeasuredPlant
from concord.features.sets.filters.closed_form import closed_form_step
from concord.features.sets.filters.criterion import plain_trace
from concord.features.sets.filters.ellipsoid import (
    Ellipsoid,
    half_widths,
    shape_matrix,
    squared_radius,
)
from concord.features.sets.filters.histories import CycleStep, SetHistory
from concord.features.sets.filters.lifted_cycle import (
    AugmentedCycle,
    DeliveredValues,
)
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.features.sets.filters.zonotope import Zonotope

PLANT = MeasuredPlant(liu2021.SYSTEM, liu2021.STATIC_OUTPUTS, liu2021.weights)
BUS = bus_of_outputs(liu2021.OUTPUTS, liu2021.STATIC_OUTPUTS, liu2021.weights)
N, G = liu2021.STATES, PLANT.length
HELD = liu2021.OUTPUTS - liu2021.STATIC_OUTPUTS


class SequenceBatch(NamedTuple):
    """Sequences: states (R, steps + 1, n) and what the bus delivered; the first is the paper's."""

    states: np.ndarray
    received: DeliveredValues

    @property
    def sequences(self) -> int:
        """R."""
        return len(self.states)

    @property
    def cycles(self) -> int:
        """How many communication cycles."""
        return self.received.values.shape[-2]

    def block(self, cycle: int, g: int = G) -> np.ndarray:
        """States (R, g n) in the g steps of a cycle, those that the paper's estimate is of."""
        steps = self.states[:, cycle * g + 1 : (cycle + 1) * g + 1]
        return steps.reshape(self.sequences, -1)


class BoundedEstimates(NamedTuple):
    """Results of an estimator for a batch, at T times that are steps of the plant.

    Attributes:
        steps: (T,).
        radius: (T, R), e' P^+ e of the whole set, at most 1 where it holds the truth. For a
            zonotope it is the square of the gauge, or an upper bound of it that is at most 1.
        trace: (T, R) of the whole set; NaN for zonotopes.
        gap: (T, R), how far at most the trace is from the least that the terms prove, relative to
            it; NaN of an estimator that solves no programme.
        centre, half_widths: (T, R, n) of the last state in the set.
        sets: per time, the set that the estimator kept.
    """

    steps: np.ndarray
    radius: np.ndarray
    trace: np.ndarray
    gap: np.ndarray
    centre: np.ndarray
    half_widths: np.ndarray
    sets: list[Ellipsoid] | list[Zonotope]

    @property
    def violations(self) -> np.ndarray:
        """(T, R): where the truth is outside; what cannot be computed counts as outside."""
        return ~(self.radius <= 1.0)


def simulate(seed: int, sequences: int, cycles: int, bus: MeasurementBus = BUS) -> SequenceBatch:
    """The paper's sequence and as many more, with the initial state in the unit ball and noise of
    four families, three of which go to its bound."""
    starts, noise = initial_and_noise(seed, sequences, cycles * G)
    states, outputs = liu2021.SYSTEM.simulate(starts, noise)
    return SequenceBatch(states, delivered(bus, liu2021.STATIC_OUTPUTS, outputs))


def initial_and_noise(seed: int, sequences: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """First states (1 + sequences, n) and noise (1 + sequences, steps, 1), the paper's first."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    noise = [liu2021.printed_noise(steps)]
    starts = [liu2021.INITIAL_STATE]
    families = list(FAMILIES.values())
    for number in range(sequences):
        noise.append(families[number % len(families)](rng, steps)[:, None])
        direction = rng.standard_normal(N)
        length = 1.0 if number % 2 else rng.uniform()
        starts.append(length * direction / np.linalg.norm(direction))
    return np.array(starts), np.array(noise)


def _square(rng: np.random.Generator, steps: int) -> np.ndarray:
    half_period, phase = rng.integers(1, 8), rng.integers(0, 8)
    return np.where((np.arange(steps) + phase) // half_period % 2, 1.0, -1.0)


def _sinusoid(rng: np.random.Generator, steps: int) -> np.ndarray:
    return np.sin(rng.uniform(0.05, np.pi) * np.arange(steps) + rng.uniform(0.0, 2.0 * np.pi))


FAMILIES: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "uniform": lambda rng, steps: rng.uniform(-1.0, 1.0, steps),
    "random ends": lambda rng, steps: rng.choice([-1.0, 1.0], steps),
    "square wave": _square,
    "sinusoid": _sinusoid,
}


# --- the estimators ------------------------------------------------------------------------------

PRIOR_SHAPE = np.eye(N)
"""Shape of the ball that holds the first state: section VI starts within 1 of zero."""

# The paper writes a plain trace, and its tables and figures need it.
printed_step: CycleStep = partial(optimal_step, criterion=plain_trace)
printed_fast_step: CycleStep = partial(closed_form_step, criterion=plain_trace)


def by_cycle(
    step: CycleStep,
    batch: SequenceBatch,
    see: Callable[[AugmentedCycle], AugmentedCycle] = lambda cycle: cycle,
    plant: MeasuredPlant = PLANT,
) -> BoundedEstimates:
    """The paper's estimator, exact or fast, on the augmented state; `see` may falsify a cycle."""
    unit = np.broadcast_to(PRIOR_SHAPE, (batch.sequences, N, N))
    first = Ellipsoid(np.zeros((batch.sequences, N)), unit)
    found = histories.by_cycle(step, plant, batch.received, first, see)
    g = plant.length
    held = batch.received.values[:, :, plant.static_outputs :]
    truths = [np.hstack([batch.block(k, g), held[:, k]]) for k in range(batch.cycles)]
    return _of_ellipsoids(found, truths, last=slice((g - 1) * N, g * N), spacing=g)


def tight(batch: SequenceBatch, plant: MeasuredPlant = PLANT) -> BoundedEstimates:
    """Conditioned on the data, cycle by cycle."""
    g = plant.length
    truths = [batch.block(cycle, g) for cycle in range(batch.cycles)]
    last = slice((g - 1) * N, g * N)
    return _of_ellipsoids(_history(batch, "tight", plant), truths, last, spacing=g)


def fast_rate(batch: SequenceBatch) -> BoundedEstimates:
    """Conditioned on the data, step by step."""
    found = _history(batch, "fast-rate", PLANT)
    truths = [batch.states[:, step + 1] for step in range(len(found.sets))]
    return _of_ellipsoids(found, truths, last=slice(0, N), spacing=1)


def zonotopes(batch: SequenceBatch) -> BoundedEstimates:
    """The zonotope filter, step by step."""
    sets = cast(list[Zonotope], _history(batch, "zonotope", PLANT).sets)
    radius = np.array([_gauges(one, batch.states[:, k + 1]) ** 2 for k, one in enumerate(sets)])
    return BoundedEstimates(
        np.arange(1, len(sets) + 1),
        radius,
        np.full(radius.shape, np.nan),
        np.full(radius.shape, np.nan),
        np.array([one.centre for one in sets]),
        np.array([zonotope.half_widths(one) for one in sets]),
        sets,
    )


def _history(batch: SequenceBatch, method: str, plant: MeasuredPlant) -> SetHistory:
    first = np.zeros(N), PRIOR_SHAPE
    return histories.sets_over(plant, batch.received, *first, method, plain_trace)


ESTIMATORS: dict[str, Callable[[SequenceBatch], BoundedEstimates]] = {
    # Corollary 1, exactly, and in closed form.
    "paper": partial(by_cycle, printed_step),
    "fast": partial(by_cycle, printed_fast_step),
    "tight": tight,
    "fast-rate": fast_rate,
    "zonotope": zonotopes,
}


def _of_ellipsoids(
    found: SetHistory, truths: list[np.ndarray], last: slice, spacing: int
) -> BoundedEstimates:
    sets = cast(list[Ellipsoid], found.sets)
    shapes = np.array([shape_matrix(one) for one in sets])
    return BoundedEstimates(
        spacing * np.arange(1, len(sets) + 1),
        np.array([squared_radius(one, truth) for one, truth in zip(sets, truths, strict=True)]),
        np.trace(shapes, axis1=-2, axis2=-1),
        found.gaps,
        np.array([one.centre[:, last] for one in sets]),
        np.array([half_widths(one)[:, last] for one in sets]),
        sets,
    )


def _gauges(sets: Zonotope, points: np.ndarray) -> np.ndarray:
    """Gauge (R,): the least-norm coefficients where they prove the point inside, else exactly."""
    offset = points - sets.centre
    shortest = (np.linalg.pinv(sets.generators) @ offset[..., None])[..., 0]
    proved = np.abs(shortest).max(-1)
    for lane in np.flatnonzero(~(proved <= 1.0)):
        own = Zonotope(sets.centre[lane], sets.generators[lane])
        proved[lane] = zonotope.gauge(own, points[lane])
    return proved
