"""The runs behind `reproduce meng2025`: all at once, as arrays over (steps, runs).

Run r has the noise that `concord run --scenario meng2025 --seed SEED --run r` has.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.gaussian_receiver import GaussianReceiver
from concord.features.measurement_bus.measurement_bus import (
    MeasurementBus,
    SlotOutcome,
    all_at_once,
    flexray,
    nobody,
    round_robin,
    try_once_discard,
)
from concord.features.measurement_bus.measurement_runs import (
    estimate,
    first_received,
    slots_of,
)
from concord.features.measurement_bus.meng2025 import DEFINITION, SENSORS, SYSTEM, paper_points
from concord.features.measurement_bus.stochastic import StochasticNonlinearity, StochasticSystem
from concord.features.measurement_bus.stochastic_ukf import RECOMMENDED, MeasurementFilter, Received
from concord.filters.gaussian import Gaussian
from concord.papers.meng2025.filter_as_printed import (
    PAPER_LITERAL,
    PAPER_LITERAL_R,
    on_fresh_rows,
    pseudo_inverse,
    update,
)
from concord.scenarios.setup import generator

EVERYBODY = range(1, SENSORS + 1)
STATIC = range(1, meng2025.STATIC_SLOTS + 1)


class MeasuredBatch(NamedTuple):
    """Truth (S + 1, R, n) and what all sensors measure (S + 1, R, m), NaN at step 0."""

    seed: int
    truth: np.ndarray
    measurement: np.ndarray

    @property
    def runs(self) -> int:
        """How many there are."""
        return self.truth.shape[1]


class SlotEstimates(NamedTuple):
    """Results of an estimator: mean (S + 1, R, n), cov, and the sensors that sent (S, R, N)."""

    mean: np.ndarray
    cov: np.ndarray
    sent: np.ndarray


class ComparedMethod(NamedTuple):
    """A row of the comparison: the schedule of the slot, the filter and its system."""

    label: str
    schedule: Schedule
    filter: MeasurementFilter = RECOMMENDED
    system: StochasticSystem = SYSTEM
    alpha: float = 1.0


def methods() -> dict[str, ComparedMethod]:
    """Return the compared methods. The first one is the reference for the others."""
    bus = flexray(SENSORS, meng2025.STATIC_SLOTS)
    # The system as a filter that ignores the stochastic nonlinearities assumes it.
    deterministic = replace(
        SYSTEM,
        process=lambda _: StochasticNonlinearity(meng2025.STATES, meng2025.STATES),
        measurement=lambda _: StochasticNonlinearity(SENSORS, meng2025.STATES),
    )
    return {
        "recommended": ComparedMethod("FlexRay, recommended", bus),
        "paper-literal": ComparedMethod(
            "FlexRay, paper-literal (pseudo-inverse)", bus, PAPER_LITERAL
        ),
        "paper-literal-R": ComparedMethod("FlexRay, paper-literal-R", bus, PAPER_LITERAL_R),
        "ignorant": ComparedMethod("FlexRay, g and b ignored", bus, system=deterministic),
        "alpha": ComparedMethod("FlexRay, alpha = 0.1", bus, alpha=0.1),
        "all": ComparedMethod("all sensors, every step", all_at_once(SENSORS)),
        "wtodp": ComparedMethod("WTODP on 1..6", try_once_discard(SENSORS, EVERYBODY)),
        "round-robin": ComparedMethod("round robin on 1..6", round_robin(SENSORS, EVERYBODY)),
        "rrp": ComparedMethod("RRP on 1..4", round_robin(SENSORS, STATIC)),
        "prediction": ComparedMethod("prediction only", nobody(SENSORS)),
    }


def simulate(seed: int, runs: int, steps: int) -> MeasuredBatch:
    """Runs 0, 1, ... under a seed, for steps 0..steps, with the noise that every driver gives."""
    scenario = DEFINITION.defaults.with_(seed=seed, steps=steps + 1)
    plant: Any = DEFINITION.plant(scenario)
    draws = [
        plant.draw(partial(generator, scenario.with_(run=run)), scenario.steps)
        for run in range(runs)
    ]
    state, _, _ = plant.initial(np.stack([one.initial for one in draws]))
    truth, readings = [], []
    for step in range(scenario.steps):
        truth.append(state)
        sensing = np.stack([one.measurement[step] for one in draws])
        readings.append(plant.observe(state, sensing, step)[..., 0, :])
        state = plant.advance(state, None, np.stack([one.process[step] for one in draws]), step)
    measurement = np.array(readings)[:, :, 1:, 0].copy()
    measurement[0] = np.nan
    return MeasuredBatch(seed, np.array(truth), measurement)


def transmit(batch: MeasuredBatch, schedule: Schedule) -> SlotOutcome:
    """Return the receiver's values after each slot, (S, R, ...)."""
    start = first_received(SYSTEM, meng2025.PRIOR_MEAN)
    return slots_of(
        MeasurementBus(SYSTEM.sizes, schedule),
        batch.measurement,
        np.broadcast_to(start, (batch.runs, SYSTEM.entries)),
    )


def carry_out(batch: MeasuredBatch, method: ComparedMethod) -> SlotEstimates:
    """One row of the comparison."""
    slots = transmit(batch, method.schedule)
    points = paper_points(method.alpha)
    runs, n = batch.runs, meng2025.STATES
    prior = Gaussian(
        np.broadcast_to(meng2025.PRIOR_MEAN, (runs, n)),
        np.broadcast_to(meng2025.PRIOR_COV, (runs, n, n)),
    )
    receiver = GaussianReceiver(method.system, method.filter, points, prior)
    beliefs = estimate(receiver, from_step_0(slots))
    return SlotEstimates(*beliefs, slots.sent)


def from_step_0(slots: SlotOutcome) -> Received:
    """Slots 1, 2, ... as those of the steps 0, 1, ...; in step 0 nothing is received."""
    nothing = np.zeros_like(slots.received[:1]), np.zeros_like(slots.fresh[:1])
    return Received(
        np.concatenate([nothing[0], slots.received]), np.concatenate([nothing[1], slots.fresh])
    )


def ranks_of_printed_cov(batch: MeasuredBatch) -> np.ndarray:
    """Rank (S, R) of Pyy of (19) in the printed algorithm, zero as the pseudo-inverse has it."""
    ranks: list[np.ndarray] = []

    def watch(matrix: np.ndarray) -> np.ndarray:
        ranks.append(np.linalg.matrix_rank(matrix, hermitian=True, rtol=1e-10))
        return pseudo_inverse(matrix)

    watched = PAPER_LITERAL._replace(update=partial(update, watch, on_fresh_rows))
    carry_out(batch, methods()["paper-literal"]._replace(filter=watched))
    return np.stack(ranks)
