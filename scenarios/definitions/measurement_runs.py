"""A measurement bus and a filter behind it over all steps at once, in batches of runs.

The same functions as in `concord.nodes.rules.measurement_bus`, so a lane here and a network of
nodes agree.
"""

from typing import NamedTuple

import numpy as np

from concord.bus.measurement_bus import MeasurementBus, SlotOutcome
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule
from concord.filters.stochastic_ukf import MeasurementFilter, Received
from concord.nodes.rules.measurement_bus import System, dynamics, observation


class BusFilter(NamedTuple):
    """A filter behind a measurement bus: what it knows, how it computes, where it starts.

    prior: mean (..., n), cov (..., n, n) at step 0.
    """

    system: System
    filter: MeasurementFilter
    points: SigmaPointRule
    prior: Gaussian


def first_received(system: System, prior_mean: np.ndarray) -> np.ndarray:
    """ybar_0 (..., m): what the prior mean (..., n) would measure at step 0."""
    return system.measure(prior_mean, 0)


def slots_of(bus: MeasurementBus, measurement: np.ndarray, received: np.ndarray) -> SlotOutcome:
    """Return the receiver's slots 1..S for measurements (S + 1, ..., m), stacked: S first.

    The first measurement, at step 0, is not looked at; `received` (..., m) is ybar_0.
    """
    slots: list[SlotOutcome] = []
    for number, measured in enumerate(measurement[1:], start=1):
        slots.append(bus.transmit(number, measured, received))
        received = slots[-1].received
    return SlotOutcome(*(np.stack(parts) for parts in zip(*slots, strict=True)))


def estimate(estimator: BusFilter, received: Received) -> Gaussian:
    """Beliefs at steps 0..S, mean (S + 1, ..., n) and cov (S + 1, ..., n, n), of what was received
    in slots 1..S, values and fresh (S, ..., m)."""
    system, method, points, prior = estimator
    state = method.start(prior, observation(system, 0), points)
    beliefs = [state.belief]
    for step, slot in enumerate(zip(*received, strict=True), start=1):
        state = method.predict(state, dynamics(system, None, step - 1), points)
        state = method.update(state, Received(*slot), observation(system, step), points)
        beliefs.append(state.belief)
    return Gaussian(
        np.stack([belief.mean for belief in beliefs]), np.stack([belief.cov for belief in beliefs])
    )
