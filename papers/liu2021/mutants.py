"""The paper's estimator with one mistake planted: the test of the guarantee must notice."""

from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.measurement_bus import MeasurementBus
from concord.papers.liu2021.runs import (
    BUS,
    BoundedEstimates,
    SequenceBatch,
    by_cycle,
    paper,
    printed_step,
    simulate,
)


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
    return _mutant(paper(simulate(seed, sequences, cycles, by_value(BUS))))


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
