"""Noise sequences of the set-membership example, and every estimator on all of them at once."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.filters.sets import zonotope
from concord.filters.sets.criterion import plain_trace
from concord.filters.sets.ellipsoid import (
    Ellipsoid,
    half_widths,
    image,
    shape_matrix,
    squared_radius,
)
from concord.filters.sets.zonotope import Zonotope
from concord.papers.liu2021.bus import MeasuredPlant, augmented, cycle_evidence, step_evidence
from concord.papers.liu2021.closed_form import closed_form_step
from concord.papers.liu2021.cycle import CycleResult
from concord.papers.liu2021.flexray_cycle import (
    AugmentedCycle,
    DeliveredValues,
    Select,
    largest_change,
    transmit,
)
from concord.papers.liu2021.recursive_estimator import optimal_step
from concord.papers.liu2021.tight_estimator import conditioned
from concord.papers.liu2021.zonotope_filter import zonotope_step
from concord.plants import liu2021

PLANT = MeasuredPlant(liu2021.SYSTEM, liu2021.STATIC_OUTPUTS, liu2021.weights)
N, G = liu2021.STATES, PLANT.length
HELD = liu2021.OUTPUTS - liu2021.STATIC_OUTPUTS
FAMILIES = ("uniform", "random ends", "square wave", "sinusoid")


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

    def block(self, cycle: int) -> np.ndarray:
        """States (R, g n) in the g steps of a cycle, those that the paper's estimate is of."""
        steps = self.states[:, cycle * G + 1 : (cycle + 1) * G + 1]
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


def simulate(
    seed: int, sequences: int, cycles: int, select: Select = largest_change
) -> SequenceBatch:
    """The paper's sequence and as many more, with the initial state in the unit ball and noise of
    four families, three of which go to its bound."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    steps = cycles * G
    noise = [liu2021.printed_noise(steps)]
    starts = [liu2021.INITIAL_STATE]
    for number in range(sequences):
        noise.append(_NOISES[number % len(_NOISES)](rng, steps)[:, None])
        direction = rng.standard_normal(N)
        length = 1.0 if number % 2 else rng.uniform()
        starts.append(length * direction / np.linalg.norm(direction))
    states, outputs = liu2021.SYSTEM.simulate(np.array(starts), np.array(noise))
    return SequenceBatch(states, transmit(outputs, liu2021.STATIC_OUTPUTS, liu2021.weights, select))


def _uniform(rng: np.random.Generator, steps: int) -> np.ndarray:
    return rng.uniform(-1.0, 1.0, steps)


def _ends(rng: np.random.Generator, steps: int) -> np.ndarray:
    return rng.choice([-1.0, 1.0], steps)


def _square(rng: np.random.Generator, steps: int) -> np.ndarray:
    half_period, phase = rng.integers(1, 8), rng.integers(0, 8)
    return np.where((np.arange(steps) + phase) // half_period % 2, 1.0, -1.0)


def _sinusoid(rng: np.random.Generator, steps: int) -> np.ndarray:
    return np.sin(rng.uniform(0.05, np.pi) * np.arange(steps) + rng.uniform(0.0, 2.0 * np.pi))


_NOISES = (_uniform, _ends, _square, _sinusoid)


# --- the estimators ------------------------------------------------------------------------------

CycleStep = Callable[[Ellipsoid, AugmentedCycle, np.ndarray], CycleResult]

# The paper writes a plain trace, and its tables and figures need it.
printed_step: CycleStep = partial(optimal_step, criterion=plain_trace)
printed_fast_step: CycleStep = partial(closed_form_step, criterion=plain_trace)


def by_cycle(
    step: CycleStep,
    batch: SequenceBatch,
    see: Callable[[AugmentedCycle], AugmentedCycle] = lambda cycle: cycle,
) -> BoundedEstimates:
    """The paper's estimator, exact or fast, on the augmented state; `see` may falsify a cycle."""
    size = G * N + HELD
    kept = Ellipsoid(np.zeros((batch.sequences, size)), _identity(batch.sequences, size))
    sets, gaps = [], []
    for cycle in range(batch.cycles):
        model = see(augmented(PLANT, batch.received, cycle))
        found = step(kept, model, batch.received.values[:, cycle])
        kept = found.after
        sets.append(kept)
        gaps.append(found.gap)
    held = batch.received.values[:, :, liu2021.STATIC_OUTPUTS :]
    truths = [np.hstack([batch.block(cycle), held[:, cycle]]) for cycle in range(batch.cycles)]
    return _of_ellipsoids(sets, gaps, truths, last=slice((G - 1) * N, G * N), per_cycle=True)


def paper(batch: SequenceBatch) -> BoundedEstimates:
    """Corollary 1, exactly."""
    return by_cycle(printed_step, batch)


def fast(batch: SequenceBatch) -> BoundedEstimates:
    """The closed form."""
    return by_cycle(printed_fast_step, batch)


def tight(batch: SequenceBatch) -> BoundedEstimates:
    """Conditioned on the data, cycle by cycle."""
    last = np.eye(G * N)[(G - 1) * N :]
    kept = Ellipsoid(np.zeros((batch.sequences, N)), _identity(batch.sequences, N))
    sets, gaps = [], []
    for cycle in range(batch.cycles):
        found = conditioned(kept, cycle_evidence(PLANT, batch.received, cycle), plain_trace)
        sets.append(found.after)
        gaps.append(found.gap)
        kept = image(sets[-1], last)
    truths = [batch.block(cycle) for cycle in range(batch.cycles)]
    return _of_ellipsoids(sets, gaps, truths, last=slice((G - 1) * N, G * N), per_cycle=True)


def fast_rate(batch: SequenceBatch) -> BoundedEstimates:
    """Conditioned on the data, step by step."""
    kept = Ellipsoid(np.zeros((batch.sequences, N)), _identity(batch.sequences, N))
    sets, gaps = [], []
    for cycle in range(batch.cycles):
        for evidence in step_evidence(PLANT, batch.received, cycle):
            found = conditioned(kept, evidence, plain_trace)
            kept = found.after
            sets.append(kept)
            gaps.append(found.gap)
    truths = [batch.states[:, step + 1] for step in range(len(sets))]
    return _of_ellipsoids(sets, gaps, truths, last=slice(0, N), per_cycle=False)


def zonotopes(batch: SequenceBatch) -> BoundedEstimates:
    """The zonotope filter, step by step."""
    kept = Zonotope(np.zeros((batch.sequences, N)), _identity(batch.sequences, N))
    sets = []
    for cycle in range(batch.cycles):
        for evidence in step_evidence(PLANT, batch.received, cycle):
            kept = zonotope_step(kept, evidence, criterion=plain_trace)
            sets.append(kept)
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


ESTIMATORS: dict[str, Callable[[SequenceBatch], BoundedEstimates]] = {
    "paper": paper,
    "fast": fast,
    "tight": tight,
    "fast-rate": fast_rate,
    "zonotope": zonotopes,
}


def _identity(lanes: int, size: int) -> np.ndarray:
    return np.broadcast_to(np.eye(size), (lanes, size, size))


def _of_ellipsoids(
    sets: list[Ellipsoid],
    gaps: list[np.ndarray],
    truths: list[np.ndarray],
    last: slice,
    per_cycle: bool,
) -> BoundedEstimates:
    shapes = np.array([shape_matrix(one) for one in sets])
    spacing = G if per_cycle else 1
    return BoundedEstimates(
        spacing * np.arange(1, len(sets) + 1),
        np.array([squared_radius(one, truth) for one, truth in zip(sets, truths, strict=True)]),
        np.trace(shapes, axis1=-2, axis2=-1),
        np.array(gaps),
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
