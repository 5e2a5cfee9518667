"""Comparisons that the paper lacks: protocols, slots, the bound W, and multipliers apart."""

from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.measurement_runs import bus_of_outputs, delivered
from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.filters.bus_readings import MeasuredPlant
from concord.features.sets.filters.criterion import plain_trace
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.papers.liu2021.runs import (
    PLANT,
    BoundedEstimates,
    SequenceBatch,
    by_cycle,
    initial_and_noise,
    printed_step,
    tight,
)

# Divisible by the cycles of every number of static slots.
STEPS = 60
SHAPES = (0.09, 1.0, 10.0, 100.0)


class ComparedSets(NamedTuple):
    """Sets of one case: how many, how many miss the state, and the mean sum of half-widths of the
    state at the end of cycles."""

    label: str
    sets: int
    outside: int
    half_widths: float


def by_slots(seed: int, sequences: int) -> list[tuple[ComparedSets, ComparedSets]]:
    """The paper's estimator and the tight one, with 0 to 4 outputs sent in turn.

    With 0 all outputs contend for every slot, with 4 none does (remark 3).
    """
    starts, noise = initial_and_noise(seed, sequences, STEPS)
    states, outputs = liu2021.SYSTEM.simulate(starts, noise)
    every = np.array([1.0, 1.0, *liu2021.weights(0)])
    compared = []
    for static in range(liu2021.OUTPUTS + 1):
        plant = MeasuredPlant(liu2021.SYSTEM, static, _weights(every[static:]))
        bus = bus_of_outputs(liu2021.OUTPUTS, static, plant.weights)
        batch = SequenceBatch(states, delivered(bus, static, outputs))
        label = _PROTOCOLS.get(static, f"FlexRay, {static} in turn")
        paper = by_cycle(printed_step, batch, plant=plant)
        compared.append((_row(label, paper), _row(label, tight(batch, plant))))
    return compared


def by_shape(batch: SequenceBatch) -> list[tuple[ComparedSets, ComparedSets]]:
    """Both estimators on the first sequence, the paper's noise, with other bounds W."""
    alone = SequenceBatch(batch.states[:1], type(batch.received)(*(p[:1] for p in batch.received)))
    compared = []
    for shape in SHAPES:
        plant = MeasuredPlant(_with_shape(shape), liu2021.STATIC_OUTPUTS, liu2021.weights)
        label = f"W = {shape:g}"
        paper = by_cycle(printed_step, alone, plant=plant)
        compared.append((_row(label, paper), _row(label, tight(alone, plant))))
    return compared


def multipliers_apart(
    batch: SequenceBatch, outcomes: dict[str, BoundedEstimates]
) -> dict[str, BoundedEstimates]:
    """The paper's estimator, with a multiplier for each noise sample, and cut by the data too."""
    apart = by_cycle(partial(optimal_step, criterion=plain_trace, samples_apart=True), batch)
    return {
        "paper: one multiplier for all samples": outcomes["paper"],
        "a multiplier for each sample": apart,
        "and cut by the received values (tight)": outcomes["tight"],
    }


_PROTOCOLS = {0: "try-once-discard only", 2: "FlexRay, 2 in turn (paper)", 4: "round robin only"}


def _weights(contending: np.ndarray):
    return lambda _: contending


def _with_shape(shape: float) -> BoundedSystem:
    system = PLANT.system
    return BoundedSystem(
        system.transition,
        system.noise_input,
        system.output,
        system.feedthrough,
        lambda _: np.array([[shape]]),
    )


def _row(label: str, outcome: BoundedEstimates) -> ComparedSets:
    widths = outcome.half_widths.sum(-1).mean()
    return ComparedSets(label, outcome.radius.size, int(outcome.violations.sum()), float(widths))
