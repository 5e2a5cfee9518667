"""A measurement bus and a filter behind it over all steps at once, in batches of runs.

The functions are those of `reception.py`, so a lane here and a network of nodes agree.
"""

import numpy as np

from concord.features.measurement_bus.gaussian_receiver import System
from concord.features.measurement_bus.measurement_bus import MeasurementBus, SlotOutcome
from concord.features.measurement_bus.reception import Receiver
from concord.features.measurement_bus.stochastic_ukf import Received
from concord.filters.gaussian import Gaussian


def first_received(system: System, prior_mean: np.ndarray) -> np.ndarray:
    """ybar_0 (..., m): what the prior mean (..., n) would measure at step 0."""
    return system.measure(prior_mean, 0)


def slots_of(
    bus: MeasurementBus, measurement: np.ndarray, received: np.ndarray, first: int = 1
) -> SlotOutcome:
    """Return the receiver's slots from `first` on for measurements (steps, ..., m), stacked.

    Measurements before that are not looked at; `received` (..., m) is what is held at first.
    """
    slots: list[SlotOutcome] = []
    for number, measured in enumerate(measurement[first:], start=first):
        slots.append(bus.transmit(number, measured, received))
        received = slots[-1].received
    return SlotOutcome(*(np.stack(parts) for parts in zip(*slots, strict=True)))


def estimate(receiver: Receiver, received: Received, first_slot: int = 1) -> Gaussian:
    """Beliefs after the slot of each step, mean (S, ..., n) and cov (S, ..., n, n).

    `received` has values and fresh (S, ..., m) of the steps 0..S - 1, from `first_slot` on.
    """
    state = receiver.start(received.values.shape[1:-1])
    beliefs: list[Gaussian] = []
    for step, slot in enumerate(zip(*received, strict=True)):
        if step > 0:
            state = receiver.predict(state, None, step)
        if step >= first_slot:
            state = receiver.update(state, Received(*slot), step)
        beliefs.append(receiver.belief(state))
    return Gaussian(
        np.stack([belief.mean for belief in beliefs]), np.stack([belief.cov for belief in beliefs])
    )
