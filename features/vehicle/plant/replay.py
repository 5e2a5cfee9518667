"""A logged drive as the plant of `network`: its sensors deliver the readings of the log."""

from collections.abc import Mapping

import numpy as np

from concord.features.vehicle.plant.corrections import channels_of_nodes, corrected, steps_over
from concord.features.vehicle.plant.network import (
    CHANNELS,
    ERRORS,
    NODES,
    SIDE_SLIP,
    DrivenOnce,
)
from concord.features.vehicle.plant.parameters import Car
from concord.features.vehicle.plant.sensors import SensorError
from concord.features.vehicle.plant.start import start_of
from concord.plants.recorded.channels import (
    ChannelReadings,
    mean_by_step,
    readings_by_step,
)


def replayed(channels: Mapping[str, ChannelReadings], car: Car, time_step_s: float) -> DrivenOnce:
    """The plant of a logged drive: its sensors deliver each reading once, with the log's own noise.

    A reading comes at the step nearest to its stamp, beside others of that step. The truth is what
    the log says of the side slip at the centre of mass, and NaN otherwise. Delays of the car's
    sensors are taken from the stamps. The start is centred on the first readings (`start_of`).

    Args:
        channels: readings by the fields of `drive_log.ColumnMap`.
        car: that was driven.
        time_step_s: between the steps.
    """
    channels = corrected(channels, car.sensors)
    grid = steps_over(channels, time_step_s)
    placed = {
        (node, place): readings_by_step(channels[name], grid)
        for node, names in enumerate(channels_of_nodes(car))
        for place, name in enumerate(names)
        if name in channels
    }
    most = max(readings.shape[1] for readings in placed.values())
    width = max(CHANNELS, *(place + 1 for _, place in placed))
    exact = np.full((grid.steps, len(NODES), most, width), np.nan)
    for (node, place), readings in placed.items():
        exact[:, node, : readings.shape[1], place] = readings
    start = start_of(channels, car.sensors)
    truth = np.full((grid.steps, len(start.mean)), np.nan)
    if "side_slip" in channels:
        truth[:, SIDE_SLIP] = mean_by_step(channels["side_slip"], grid)
    quiet = tuple(tuple(SensorError(0.0) for _ in errors) for errors in ERRORS)
    return DrivenOnce(time_step_s, truth, exact, start.mean, quiet, False, start.std)
