"""A logged drive as the plant of `network`: its sensors deliver the readings of the log."""

from collections.abc import Mapping

import numpy as np

from concord.plants.recorded.channels import (
    ChannelReadings,
    grid_over,
    mean_by_step,
    readings_by_step,
)
from concord.plants.vehicle.corrections import channels_of_nodes, corrected
from concord.plants.vehicle.drive_log import speeds_in
from concord.plants.vehicle.network import (
    CHANNELS,
    ERRORS,
    HEADING,
    NODES,
    SIDE_SLIP,
    SPEED,
    STATE_NAMES,
    STEERING,
    YAW_RATE,
    DrivenOnce,
)
from concord.plants.vehicle.parameters import Car
from concord.plants.vehicle.sensors import SensorError


def replayed(channels: Mapping[str, ChannelReadings], car: Car, time_step_s: float) -> DrivenOnce:
    """The plant of a logged drive: its sensors deliver each reading once, with the log's own noise.

    A reading comes at the step nearest to its stamp, beside others of that step. The truth is what
    the log says of the side slip at the centre of mass, and NaN otherwise. Delays of the car's
    sensors are taken from the stamps. The start is centred on the first readings,
    with the spread of `PRIOR_STD`, several times that of the sensors.

    Args:
        channels: readings by the fields of `drive_log.ColumnMap`.
        car: that was driven.
        time_step_s: between the steps.
    """
    channels = corrected(channels, car.sensors)
    grid = grid_over(channels, time_step_s)
    placed = {
        (node, place): readings_by_step(channels[name], grid)
        for node, names in enumerate(channels_of_nodes(car))
        for place, name in enumerate(names)
        if name in channels
    }
    most = max(readings.shape[1] for readings in placed.values())
    exact = np.full((grid.steps, len(NODES), most, CHANNELS), np.nan)
    for (node, place), readings in placed.items():
        exact[:, node, : readings.shape[1], place] = readings
    truth = np.full((grid.steps, len(STATE_NAMES)), np.nan)
    if "side_slip" in channels:
        truth[:, SIDE_SLIP] = mean_by_step(channels["side_slip"], grid)
    quiet = tuple(tuple(SensorError(0.0) for _ in errors) for errors in ERRORS)
    return DrivenOnce(time_step_s, truth, exact, start_of(channels), quiet, prior_error=False)


def start_of(channels: Mapping[str, ChannelReadings]) -> np.ndarray:
    """Return the state (6,) that the first readings tell, 0 for what they do not."""
    start = np.zeros(len(STATE_NAMES))
    told = {
        YAW_RATE: ("yaw_rate",),
        SPEED: speeds_in(channels),
        HEADING: ("course",),
        STEERING: ("steering",),
    }
    for state, names in told.items():
        first = [channels[n].values[0] for n in names if n in channels and len(channels[n].values)]
        start[state] = np.mean(first) if first else 0.0
    return start
