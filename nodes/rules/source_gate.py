"""Outliers are judged once, by the node that took them, before any other node hears of them.

Were each receiver to judge by its own belief, some would take a record and some refuse it. A record
that its source refused does not exist: it is refused alike everywhere.
"""

from collections.abc import Sequence

import numpy as np

from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.nodes.rules.lane_rule import Failures
from concord.nodes.rules.local_filter import (
    Sensor,
    SensorGroup,
    finite_lanes,
    update_with_reading,
    where,
)
from concord.nodes.rules.window_filter import WindowFilter, Windows


def judged(
    window_filter: WindowFilter,
    windows: Windows,
    readings: np.ndarray,
    control: np.ndarray | None,
    own: Sequence[SensorGroup],
    gates: Sequence[float],
) -> tuple[np.ndarray, Failures]:
    """Readings (R, M, r, d) of lanes in the step after that of the windows, without outliers.

    `own` are the sensors of the lanes. Returns also how often what went wrong.
    """
    judges = [group for group in own if group.sensor.gate is not None or gates]
    if not judges:
        return readings, {}
    belief, sound = window_filter.predicted(windows, control)
    kept, gated = readings.copy(), np.zeros(sound.shape, dtype=np.int64)
    step, filter = windows.step + 1, window_filter.filter
    for nodes, sensor in judges:
        before = Gaussian(belief.mean[:, nodes], belief.cov[:, nodes])
        kept[:, nodes], gated[:, nodes] = without_outliers(
            before, readings[:, nodes], sensor, step, filter, gates
        )
    return kept, {"predict-failed": ~sound, "gated": gated}


def without_outliers(
    belief: Gaussian,
    delivered: np.ndarray,
    sensor: Sensor,
    step: int,
    filter: Filter,
    gates: Sequence[float] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Readings (..., r, d) with NaN for those beyond the gate, and how many (...) those are.

    The gate is the sensor's own, else that of `gates` for as many entries as were taken.
    `belief` (..., n) is that before the readings; each is judged given the ones before it that
    passed.
    """
    kept = delivered.copy()
    gated = np.zeros(delivered.shape[:-2], dtype=np.int64)
    for place in range(delivered.shape[-2]):
        reading = delivered[..., place, :]
        if np.isnan(reading).all():
            continue
        interpreted = sensor.interpret(reading)
        result = update_with_reading(belief, interpreted, step, sensor, filter)
        refused = result.normalised_innovation_squared > _gates(interpreted[0], sensor, gates)
        kept[..., place, :] = np.where(refused[..., None], np.nan, reading)
        gated += refused
        belief = where(~refused & finite_lanes(result.belief), result.belief, belief)
    return kept, gated


def _gates(value: np.ndarray, sensor: Sensor, gates: Sequence[float]) -> np.ndarray:
    """The threshold (...) for each of some readings (..., m); what was not taken passes."""
    taken = np.count_nonzero(~np.isnan(value), axis=-1)
    if sensor.gate is not None:
        return np.where(taken > 0, sensor.gate, np.inf)
    return np.array([np.inf, *gates])[taken] if len(gates) else np.full(np.shape(taken), np.inf)
