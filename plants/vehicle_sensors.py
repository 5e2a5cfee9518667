"""How a car's sensors err: noise, bias, outliers, and noise that grows on the way."""

from typing import NamedTuple

import numpy as np

from plants.draws import Array


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


def noise_std(error: SensorError, time_s: Array) -> Array:
    """Standard deviation (steps,) of the noise at times (steps,), outliers apart."""
    std = np.full(np.shape(time_s), error.std)
    for start_s, factor in error.changes:
        std = np.where(time_s >= start_s - 1e-9, factor * error.std, std)
    return std


def contaminated(
    error: SensorError, generator: np.random.Generator, shape: tuple[int, ...]
) -> Array:
    """Standard normals of a shape, of which a share is `outlier_scale` times as large.

    Which ones are outliers is drawn after the normals, so a sensor without outliers errs by the
    same numbers otherwise.
    """
    normal = generator.standard_normal(shape)
    chosen = generator.random(shape) < error.outlier_share
    return np.where(chosen, error.outlier_scale * normal, normal)


def draw_errors(
    error: SensorError, generator: np.random.Generator, time_s: Array, runs: int
) -> Array:
    """Errors (steps, runs) at times (steps,)."""
    normal = contaminated(error, generator, (runs, len(time_s))).T
    return error.bias + noise_std(error, time_s)[:, None] * normal
