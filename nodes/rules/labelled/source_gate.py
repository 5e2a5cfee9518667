"""Outliers are judged once, by the node that took them, before any other node hears of them.

Were each receiver to judge by its own belief, some would take a record and some refuse it. A record
that its source refused does not exist: it is refused alike everywhere. The same is true of a record
that the source withholds, since the other nodes can nearly predict it.
"""

from collections.abc import Sequence

import numpy as np

from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import solve_spd
from concord.nodes.rules.labelled.window_filter import WindowFilter, Windows
from concord.nodes.rules.lane_rule import Failures
from concord.nodes.rules.local_filter import (
    Sensor,
    SensorGroup,
    finite_lanes,
    update_with_reading,
    where,
)


def kullback_leibler(belief: Gaussian, predicted: Gaussian) -> np.ndarray:
    """Return the Kullback-Leibler divergence (...) of beliefs (..., n) from others, in nats.

    It is 0 where both are equal, and NaN or infinite where a covariance is not positive definite.
    Source: Kullback (1959), Information theory and statistics, section 9.1.
    """
    change = (belief.mean - predicted.mean)[..., None]
    shift = (change * solve_spd(predicted.cov, change)).sum(axis=(-1, -2))
    ratio = np.trace(solve_spd(predicted.cov, belief.cov), axis1=-2, axis2=-1)
    volumes = np.linalg.slogdet(predicted.cov)[1] - np.linalg.slogdet(belief.cov)[1]
    return 0.5 * (shift + ratio - belief.mean.shape[-1] + volumes)


def judged(
    window_filter: WindowFilter,
    windows: Windows,
    readings: np.ndarray,
    control: np.ndarray | None,
    own: Sequence[SensorGroup],
    gates: Sequence[float],
    withhold_below: float = 0.0,
) -> tuple[np.ndarray, Failures]:
    """Readings (R, M, r, d) of lanes in the step after that of the windows, without outliers.

    `own` are the sensors of the lanes. A lane has no readings if the Kullback-Leibler divergence of
    its belief with them from its prediction is below `withhold_below` nats. Returns also how often
    what went wrong, and how many readings were withheld.
    """
    asked = bool(gates) or withhold_below > 0
    judges = [group for group in own if group.sensor.gate is not None or asked]
    if not judges:
        return readings, {}
    belief, sound = window_filter.predicted(windows, control)
    kept = readings.copy()
    gated = np.zeros(sound.shape, dtype=np.int64)
    withheld = np.zeros_like(gated)
    step, filter = windows.step + 1, window_filter.filter
    for nodes, sensor in judges:
        before = Gaussian(belief.mean[:, nodes], belief.cov[:, nodes])
        passed, gated[:, nodes], after = without_outliers(
            before, readings[:, nodes], sensor, step, filter, gates
        )
        if withhold_below > 0:
            there = (~np.isnan(passed)).any(axis=-1)
            little = kullback_leibler(after, before) < withhold_below
            passed[little] = np.nan
            withheld[:, nodes] = there.sum(axis=-1) * little
        kept[:, nodes] = passed
    return kept, {"predict-failed": ~sound, "gated": gated, "withheld": withheld}


def without_outliers(
    belief: Gaussian,
    delivered: np.ndarray,
    sensor: Sensor,
    step: int,
    filter: Filter,
    gates: Sequence[float] = (),
) -> tuple[np.ndarray, np.ndarray, Gaussian]:
    """Readings (..., r, d) with NaN for those beyond the gate, and how many (...) those are.

    Returns also the beliefs (..., n) after the readings that passed. The gate is the sensor's own,
    else that of `gates` for as many entries as were taken. `belief` (..., n) is that before the
    readings; each is judged given the ones before it that passed.
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
    return kept, gated, belief


def _gates(value: np.ndarray, sensor: Sensor, gates: Sequence[float]) -> np.ndarray:
    """The threshold (...) for each of some readings (..., m); what was not taken passes."""
    taken = np.count_nonzero(~np.isnan(value), axis=-1)
    if sensor.gate is not None:
        return np.where(taken > 0, sensor.gate, np.inf)
    return np.array([np.inf, *gates])[taken] if len(gates) else np.full(np.shape(taken), np.inf)
