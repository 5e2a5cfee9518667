"""Comparisons that the paper lacks: protocols, slots, the bound W, multipliers, planted mistakes.

With a planted mistake the test of the guarantee must notice.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.measurement_bus import MeasurementBus
from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.delivered import bus_of_outputs, delivered
from concord.features.sets.filters.bus_readings import MeasuredPlant
from concord.features.sets.filters.criterion import plain_trace
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.papers.liu2021.runs import (
    BUS,
    ESTIMATORS,
    PLANT,
    BoundedEstimates,
    SequenceBatch,
    by_cycle,
    initial_and_noise,
    printed_step,
    simulate,
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


Pair = tuple[ComparedSets, ComparedSets]
"""Of the paper's estimator and of the tight one."""


def by_slots(seed: int, sequences: int) -> list[Pair]:
    """Both estimators with 0 to 4 outputs sent in turn.

    With 0 all outputs contend for every slot, with 4 none does (remark 3).
    """
    starts, noise = initial_and_noise(seed, sequences, STEPS)
    states, outputs = liu2021.SYSTEM.simulate(starts, noise)
    every = np.array([1.0, 1.0, *liu2021.weights(0)])
    compared = []
    for static in range(liu2021.OUTPUTS + 1):
        plant = MeasuredPlant(liu2021.SYSTEM, static, lambda _, n=static: every[n:])
        bus = bus_of_outputs(liu2021.OUTPUTS, static, plant.weights)
        batch = SequenceBatch(states, delivered(bus, static, outputs))
        compared.append(_pair(_PROTOCOLS.get(static, f"FlexRay, {static} in turn"), batch, plant))
    return compared


def by_shape(batch: SequenceBatch) -> list[Pair]:
    """Both estimators on the first sequence, the paper's noise, with other bounds W."""
    alone = SequenceBatch(batch.states[:1], type(batch.received)(*(p[:1] for p in batch.received)))
    compared = []
    for shape in SHAPES:
        bounded = replace(PLANT.system, noise_shape=lambda _, w=shape: np.array([[w]]))
        plant = MeasuredPlant(bounded, liu2021.STATIC_OUTPUTS, liu2021.weights)
        compared.append(_pair(f"W = {shape:g}", alone, plant))
    return compared


def _pair(label: str, batch: SequenceBatch, plant: MeasuredPlant) -> Pair:
    paper, tighter = (
        ComparedSets(
            label, one.radius.size, int(one.violations.sum()),
            float(one.half_widths.sum(-1).mean()),
        )
        for one in (by_cycle(printed_step, batch, plant=plant), tight(batch, plant))
    )  # fmt: skip
    return paper, tighter


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


# --- planted mistakes ----------------------------------------------------------------------------


class Mutant(NamedTuple):
    """Effect of a planted mistake on the same kind of sequences.

    Attributes:
        outside: instants at which the truth is outside the ellipsoid.
        contradicted: instants with no ellipsoid left: the terms contradict each other.
        sequences: how many sequences are touched by either. instants, of: how many there are.
    """

    outside: int
    contradicted: int
    sequences: int
    instants: int
    of: int


def mutant_of_sign(batch: SequenceBatch) -> Mutant:
    """The sign of Xi in (20) flipped, which is the same as negative weights."""
    return _mutant(by_cycle(printed_step, batch, lambda c: c._replace(weights=-c.weights)))


def mutant_of_rule(seed: int, sequences: int, cycles: int) -> Mutant:
    """Winners by Q y^2, as the tables suggest, and the estimator believing in (5)."""
    return _mutant(ESTIMATORS["paper"](simulate(seed, sequences, cycles, by_value(BUS))))


class _ByValue(MeasurementBus):
    def bids(self, slot: int, measurement: np.ndarray, received: np.ndarray) -> np.ndarray:
        return super().bids(slot, measurement, np.zeros_like(received))


def by_value(bus: MeasurementBus) -> MeasurementBus:
    """The same bus, whose sensors bid what they measure, not how much it has changed."""
    return _ByValue(bus.sizes, bus.schedule, bus.weights)


def _mutant(outcome: BoundedEstimates) -> Mutant:
    contradicted = np.isnan(outcome.radius)
    hurt = outcome.violations
    return Mutant(
        outside=int((hurt & ~contradicted).sum()),
        contradicted=int(contradicted.sum()),
        sequences=int(hurt.any(0).sum()),
        instants=hurt.size,
        of=hurt.shape[1],
    )
