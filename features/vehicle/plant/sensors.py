"""How a car's sensors err: noise, bias, outliers, and noise that grows on the way."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.drive import Drive


class SensorError(NamedTuple):
    """The error of one channel, in its own unit.

    Attributes:
        std: standard deviation of the noise.
        bias: added to every reading.
        changes: (time in s, factor) pairs, ascending; from each time on the noise is that many
            times `std`.
        outlier_share: how many of the readings are outliers, 0 to 1.
        outlier_scale: their noise over that of the others.
    """

    std: float
    bias: float = 0.0
    changes: tuple[tuple[float, float], ...] = ()
    outlier_share: float = 0.0
    outlier_scale: float = 20.0


def noise_std(error: SensorError, time_s: np.ndarray) -> np.ndarray:
    """Standard deviation (steps,) of the noise at times (steps,), outliers apart."""
    std = np.full(np.shape(time_s), error.std)
    for start_s, factor in error.changes:
        std = np.where(time_s >= start_s - 1e-9, factor * error.std, std)
    return std


def contaminated(
    error: SensorError, generator: np.random.Generator, shape: tuple[int, ...]
) -> np.ndarray:
    """Standard normals of a shape, of which a share is `outlier_scale` times as large.

    Which ones are outliers is drawn after the normals, so a sensor without outliers errs by the
    same numbers otherwise.
    """
    normal = generator.standard_normal(shape)
    chosen = generator.random(shape) < error.outlier_share
    return np.where(chosen, error.outlier_scale * normal, normal)


def draw_errors(
    error: SensorError, generator: np.random.Generator, time_s: np.ndarray, runs: int
) -> np.ndarray:
    """Errors (steps, runs) at times (steps,)."""
    normal = contaminated(error, generator, (runs, len(time_s))).T
    return error.bias + noise_std(error, time_s)[:, None] * normal


TEST_CAR = {
    "steering_rad": SensorError(0.0005),
    "yaw_rate_rad_s": SensorError(0.005),
    "side_slip_rad": SensorError(math.radians(0.05)),
    "speed_m_s": SensorError(0.10),
    "longitudinal_acceleration_m_s2": SensorError(0.05, bias=0.02),
    "lateral_acceleration_m_s2": SensorError(0.10),
    "wheel_speed_m_s": SensorError(0.10),
}
"""A car for measurements, by the fields of `Drive`; an optical sensor tells the side slip."""


def logged(drive: Drive, errors: Mapping[str, SensorError], rng: np.random.Generator) -> Drive:
    """A drive as sensors that err so would log it; fields that have no sensor stay as they are."""

    def noisy(values: np.ndarray, error: SensorError) -> np.ndarray:
        columns = values.reshape(drive.steps, -1)
        drawn = [draw_errors(error, rng, drive.time_s, 1) for _ in columns.T]
        return (columns + np.concatenate(drawn, axis=1)).reshape(values.shape)

    return drive._replace(
        **{field: noisy(getattr(drive, field), error) for field, error in errors.items()}
    )
