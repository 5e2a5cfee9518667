"""Outliers are judged once, by the node that took them, before anybody else has heard of them.

Were each receiver to judge by its own belief, some would take a record and some refuse it. A record
that its source refused does not exist: it is refused alike everywhere.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule
from filters.ukf import update
from nodes.local_filter import Sensor, finite, with_state_noise
from nodes.messages import Array


def without_outliers(
    belief: Gaussian,
    delivered: Array,
    sensor: Sensor,
    step: int,
    points: SigmaPointRule,
    gates: Sequence[float] = (),
) -> tuple[Array, tuple[str, ...]]:
    """Readings (r, d) with NaN for those beyond the gate, and a name for each of these.

    The gate is the sensor's own, else that of `gates` for as many entries as were taken.
    `belief` is that before the readings; each is judged given the ones before it that passed.
    """
    kept = delivered.copy()
    gated: list[str] = []
    for place, reading in enumerate(delivered):
        if np.isnan(reading).all():
            continue
        value, noise_cov = sensor.interpret(reading)
        noise_cov = with_state_noise(noise_cov, sensor, belief, step)
        gate = sensor.gate
        if gate is None and len(gates) > 0:
            gate = gates[int(np.count_nonzero(~np.isnan(value))) - 1]
        result = update(
            belief,
            value,
            partial(sensor.measure, step=step),
            noise_cov,
            points,
            residual=sensor.residual,
        )
        if gate is not None and result.normalised_innovation_squared > gate:
            kept[place] = np.nan
            gated.append("gated")
        elif finite(result.belief):
            belief = result.belief
    return kept, tuple(gated)
