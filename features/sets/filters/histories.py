"""Sets over a whole history of communication cycles: Algorithm 1 of Liu et al. (2021) and others.

Lanes (...) are histories side by side.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.bus_readings import (
    MeasuredPlant,
    augmented,
    cycle_evidence,
    step_evidence,
)
from concord.features.sets.filters.closed_form import closed_form_step
from concord.features.sets.filters.criterion import Criterion, unit_free
from concord.features.sets.filters.cycle import CycleResult
from concord.features.sets.filters.ellipsoid import Ellipsoid, from_shape, image
from concord.features.sets.filters.lifted_cycle import AugmentedCycle, DeliveredValues
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.features.sets.filters.tight_estimator import conditioned
from concord.features.sets.filters.zonotope import Zonotope
from concord.features.sets.filters.zonotope_filter import zonotope_step
from concord.filters.linalg import join_entries

CycleStep = Callable[[Ellipsoid, AugmentedCycle, np.ndarray], CycleResult]


class SetHistory(NamedTuple):
    """Sets over a history, and the duality gap (T, ...) of each relative to its trace.

    The gap is NaN of methods that solve no programme, and in lanes that are lost.
    """

    sets: list[Ellipsoid] | list[Zonotope]
    gaps: np.ndarray


Histories = Callable[[MeasuredPlant, DeliveredValues, Ellipsoid, Criterion], SetHistory]


def sets_over(
    plant: MeasuredPlant,
    received: DeliveredValues,
    centre: np.ndarray,
    shape: np.ndarray,
    method: str = "tight",
    criterion: Criterion = unit_free,
) -> SetHistory:
    """The sets that hold the state, given what a bus delivered from step 0 on.

    Args:
        plant: with l outputs sent in turn and m - l that contend; a cycle has g = l + 1 steps.
        received: as `concord.features.sets.delivered.delivered` makes it.
        centre, shape: (..., n) and (n, n), the ellipsoid that holds the state at step 0.
        method: "paper" and "fast" give a set of (x in the g steps, held values) for each cycle,
            "tight" of x in the g steps; "fast-rate" and "zonotope" of x for each step.
        criterion: the weights of the states; `plain_trace` for the paper's.

    Raises:
        ValueError: an unknown method, or a centre and a shape that are no ellipsoid of the states.
    """
    if method not in METHODS:
        raise ValueError(f"method {method!r}: must be one of {', '.join(METHODS)}")
    lanes = received.winner.shape[:-1]
    n = plant.system.transition(0).shape[-1]
    if np.shape(centre)[-1:] != (n,) or np.shape(shape) != (n, n):
        raise ValueError(
            f"centre {np.shape(centre)} and shape {np.shape(shape)} for a plant of {n} states; "
            f"give ({n},) and ({n}, {n})"
        )
    sound = np.isfinite(shape).all() and np.allclose(shape, np.transpose(shape))
    values = np.linalg.eigvalsh(shape) if sound else np.array([-np.inf])
    if values[0] < -1e-12 * max(values[-1], 0.0):
        raise ValueError("shape: must be finite, symmetric and without a negative eigenvalue")
    first = from_shape(np.broadcast_to(centre, (*lanes, n)), np.broadcast_to(shape, (*lanes, n, n)))
    return METHODS[method](plant, received, first, criterion)


def augmented_prior(
    state: Ellipsoid, held: np.ndarray, steps: int, held_half_width: float = 1.0
) -> Ellipsoid:
    """The ellipsoid of (x in the steps before, held) at first: one block for each of the steps.

    Args:
        state: (..., n), of the first state; blocks of states before it never matter.
        held: (..., c), the values held, about which the ellipsoid has this half-width; 1 in the
            paper, whose P(0) is the identity.
    """
    n, r = state.factor.shape[-2:]
    count = held.shape[-1]
    lanes = state.centre.shape[:-1]
    factor = np.zeros((*lanes, steps * n + count, steps * r + count))
    for block in range(steps):
        rows, columns = slice(block * n, (block + 1) * n), slice(block * r, (block + 1) * r)
        factor[..., rows, columns] = state.factor
    factor[..., steps * n :, steps * r :] = held_half_width * np.eye(count)
    return Ellipsoid(join_entries(*(state.centre,) * steps, held), factor)


def by_cycle(
    step: CycleStep,
    plant: MeasuredPlant,
    received: DeliveredValues,
    first: Ellipsoid,
    see: Callable[[AugmentedCycle], AugmentedCycle] = lambda cycle: cycle,
) -> SetHistory:
    """Algorithm 1 with the step that finds an ellipsoid; `see` may change what it is told."""
    kept = augmented_prior(first, received.held[..., 0, :], plant.length)
    sets, gaps = [], []
    for cycle in range(received.values.shape[-2]):
        model = see(augmented(plant, received, cycle))
        found = step(kept, model, received.values[..., cycle, :])
        kept = found.after
        sets.append(kept)
        gaps.append(found.gap)
    return SetHistory(sets, np.array(gaps))


def _paper(
    plant: MeasuredPlant, received: DeliveredValues, first: Ellipsoid, criterion: Criterion
) -> SetHistory:
    return by_cycle(partial(optimal_step, criterion=criterion), plant, received, first)


def _fast(
    plant: MeasuredPlant, received: DeliveredValues, first: Ellipsoid, criterion: Criterion
) -> SetHistory:
    return by_cycle(partial(closed_form_step, criterion=criterion), plant, received, first)


def _tight(
    plant: MeasuredPlant, received: DeliveredValues, first: Ellipsoid, criterion: Criterion
) -> SetHistory:
    n = first.centre.shape[-1]
    last = np.eye(plant.length * n)[-n:]
    sets, gaps = [], []
    for cycle in range(received.values.shape[-2]):
        found = conditioned(first, cycle_evidence(plant, received, cycle), criterion)
        sets.append(found.after)
        gaps.append(found.gap)
        first = image(found.after, last)
    return SetHistory(sets, np.array(gaps))


def _fast_rate(
    plant: MeasuredPlant, received: DeliveredValues, first: Ellipsoid, criterion: Criterion
) -> SetHistory:
    sets, gaps = [], []
    for cycle in range(received.values.shape[-2]):
        for evidence in step_evidence(plant, received, cycle):
            found = conditioned(first, evidence, criterion)
            first = found.after
            sets.append(first)
            gaps.append(found.gap)
    return SetHistory(sets, np.array(gaps))


def _zonotopes(
    plant: MeasuredPlant, received: DeliveredValues, first: Ellipsoid, criterion: Criterion
) -> SetHistory:
    kept = Zonotope(first.centre, first.factor)
    sets = []
    for cycle in range(received.values.shape[-2]):
        for evidence in step_evidence(plant, received, cycle):
            kept = zonotope_step(kept, evidence, criterion=criterion)
            sets.append(kept)
    return SetHistory(sets, np.full((len(sets), *first.centre.shape[:-1]), np.nan))


METHODS: dict[str, Histories] = {
    "paper": _paper,
    "fast": _fast,
    "tight": _tight,
    "fast-rate": _fast_rate,
    "zonotope": _zonotopes,
}
