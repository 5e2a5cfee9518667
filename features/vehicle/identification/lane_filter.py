"""The filter that hears every sensor of a log, for many cars at once: lanes of one batch."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from concord.features.vehicle.identification.logged_readings import COURSE, SENSORS, LoggedReadings
from concord.features.vehicle.identification.sought import process_noise_covs
from concord.features.vehicle.plant.corrections import earlier, earlier_by
from concord.features.vehicle.plant.model import SingleTrack, Tyre, axles_of
from concord.features.vehicle.plant.network import (
    SENSORS_OF_NODES,
    SIDE_SLIP,
    SPEED,
    STEERING,
    YAW_RATE,
    DrivenCar,
    sensor,
)
from concord.features.vehicle.plant.parameters import Car
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.filters.ukf import predict, update
from concord.filters.update import Update
from concord.plants.range_bearing import wrapped

OUTPUTS = ("yaw_rate", "lateral_acceleration", "side_slip")
"""The sensors of what steering and speed drive."""
BLOCK_SAMPLES = 200
"""Innovations that are kept at a time."""


class LaneFilter:
    """The filter of many lanes of cars over one log."""

    def __init__(self, log: LoggedReadings, lanes: Car, tyre: Tyre, count: int) -> None:
        self._log, self._count, self._sheets = log, count, lanes.sensors
        track = SingleTrack(lanes, axles_of(lanes), tyre, log.time_step_s)
        self._model = DrivenCar(track, positioned=log.positioned)
        self._states = len(log.start.mean)
        self._noise_cov = process_noise_covs(lanes.process_noise, log.time_step_s, self._states)
        self._noise_cov = np.broadcast_to(self._noise_cov, (count, self._states, self._states))
        nodes = range(len(SENSORS_OF_NODES))
        self._sensors = [sensor(node, track, log.positioned) for node in nodes]
        every = enumerate(SENSORS)
        measured = [place for place, name in every if log.positioned or name != "position"]
        self._places = [measured.index(channel) for channel in log.channels]
        # The log was read with the ratio of the file.
        self._gain = lanes.steering_ratio / log.car.steering_ratio
        sheets = [getattr(lanes.sensors, name) for name in log.sensors]
        noise = np.stack([np.broadcast_to(sheet.noise, count) for sheet in sheets], axis=-1)
        self._reading_cov = np.square(noise)[..., None] * np.eye(len(sheets))

    def blocks(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Innovations (B, lanes, m) that count, and their covariances, block by block."""
        kept = []
        for _, counts, found in self.updates():
            if counts.any():
                kept.append((np.where(counts, found.innovation, np.nan), found.innovation_cov))
            if len(kept) == BLOCK_SAMPLES:
                yield _stacked(kept)
                kept = []
        if kept:
            yield _stacked(kept)

    def updates(self) -> Iterator[tuple[np.ndarray, np.ndarray, Update]]:
        """Of each step with readings: the readings (lanes, m), which count, and the update."""
        log, n, rule = self._log, self._states, scaled_unscented(self._states)
        transition = partial(self._model.transition, control=None, step=0)
        belief = Gaussian(
            np.broadcast_to(log.start.mean, (self._count, n)),
            np.broadcast_to(np.diag(np.square(log.start.std)), (self._count, n, n)),
        )
        for step, (reading, counts) in enumerate(zip(*self._readings(), strict=True)):
            if step:
                belief = predict(belief, transition, self._noise_cov, rule)
            if np.isnan(reading).all():
                continue
            found = update(
                belief, reading, self._measure, self._reading_cov, rule, residual=self._residual
            )
            belief = found.belief
            yield reading, counts, found

    def left_over(self) -> np.ndarray:
        """Return the readings (steps, lanes, m) of `OUTPUTS` less those of the cars that the logged
        steering and speed drive; NaN for other sensors, and for readings that do not count."""
        readings, counted = self._readings()
        told = np.where(counted & np.isin(self._log.sensors, OUTPUTS), readings, np.nan)
        steering = self._driving(readings, "steering") - self._sheets.steering.offset
        speed = self._log.speed_m_s[:, None]
        if "wheel_speed" in self._log.sensors:
            speed = self._driving(readings, "wheel_speed")
        state = np.broadcast_to(self._log.start.mean, (self._count, self._states)).copy()
        left = np.empty_like(readings)
        for step in range(len(readings)):
            state[:, STEERING], state[:, SPEED] = steering[step] / self._gain, speed[step]
            left[step] = self._residual(told[step], self._measure(state))
            state = self._model.transition(state, None, step)
        return left

    def _driving(self, readings: np.ndarray, sensor: str) -> np.ndarray:
        """The mean (steps, lanes) of the readings of a sensor, on lines between them."""
        steps, every = np.arange(len(readings)), []
        for place in np.flatnonzero(np.equal(self._log.sensors, sensor)):
            lanes = readings[..., place].T
            known = [np.isfinite(lane) for lane in lanes]
            every.append(
                [np.interp(steps, steps[k], y[k]) for k, y in zip(known, lanes, strict=True)]
            )
        mean: np.ndarray = np.mean(every, axis=0).T
        return mean

    def _readings(self) -> tuple[np.ndarray, np.ndarray]:
        """The readings (steps, lanes, m), moved by the delays of each lane beyond the car's, and
        which ones count: the same in all lanes, or a delay would choose what it is judged by."""
        log, columns, counted = self._log, [], []
        for name, logged in zip(log.sensors, log.readings.T, strict=True):
            delays = getattr(self._sheets, name).delay_s - getattr(log.car.sensors, name).delay_s
            delays = np.broadcast_to(delays, self._count)
            samples, lanes = np.unique(delays / log.time_step_s, return_inverse=True)
            moved = [earlier(logged, value) for value in samples]
            columns.append(np.stack(moved, axis=-1)[:, lanes])
            kept = [earlier_by(log.counted, round(value)) == 1.0 for value in samples]
            counted.append(np.stack(kept, axis=-1)[:, lanes])
        return np.stack(columns, axis=-1), np.stack(counted, axis=-1)

    def _measure(self, state: np.ndarray) -> np.ndarray:
        """The channels (S, lanes, m) of states (S, lanes, n)."""
        every = [one.measure(state, 0) for one in self._sensors]
        steering = self._sheets.steering.offset
        every[2][..., 0] = self._gain * (every[2][..., 0] - steering) + steering
        stacked = np.concatenate([*every, self.slip(state)[..., None]], axis=-1)
        return stacked[..., self._places]

    def slip(self, state: np.ndarray) -> np.ndarray:
        """The reading of the slip sensor in states (..., lanes, n)."""
        turning = self._sheets.slip_sensor_ahead_m * state[..., YAW_RATE]
        slip = np.arctan(np.tan(state[..., SIDE_SLIP]) + turning / np.maximum(state[..., SPEED], 1))
        return slip + self._sheets.side_slip.offset

    def _residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (..., m), a course within (-pi, pi]."""
        difference = a - b
        for place in np.flatnonzero(np.equal(self._log.channels, COURSE)):
            difference[..., place] = wrapped(difference[..., place])
        return difference


def _stacked(kept: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    innovations, covs = zip(*kept, strict=True)
    return np.stack(innovations), np.stack(covs)
