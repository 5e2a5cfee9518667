"""Likelihood of the innovations of a drive, its gradient, and its Fisher information.

The innovations v with covariance S are those of the filter that hears every sensor of
`vehicle-network`, and the side slip where it is logged. With the negative logarithm
L = sum (log det S + v' S^-1 v) / 2 and derivatives v_i, S_i by parameter i:

    g_i  = sum tr(S^-1 S_i) / 2 + v' S^-1 v_i - v' S^-1 S_i S^-1 v / 2
    M_ij = sum tr(S^-1 S_i S^-1 S_j) / 2 + v_i' S^-1 v_j

Source: Gupta and Mehra (1974), Computational aspects of maximum likelihood estimation and reduction
in sensitivity function calculations. Derivatives are differences between lanes of one batch.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.experiments.identification.sought import Sought, car_with, process_noise_covs
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.filters.ukf import predict, update
from concord.plants.vehicle.corrections import earlier
from concord.plants.vehicle.drive import FRONT_LEFT, REAR_LEFT, Drive
from concord.plants.vehicle.model import SingleTrack, Tyre, axles_of
from concord.plants.vehicle.network import (
    PRIOR_STD,
    SIDE_SLIP,
    SPEED,
    YAW_RATE,
    DrivenCar,
    sensor,
)
from concord.plants.vehicle.parameters import Car

DIFFERENCE = 1e-5
"""Of a parameter, in spreads."""
ENDS_S = 0.25
"""Innovations so near to the ends do not count: delays move readings across the ends."""
BLOCK_SAMPLES = 200
"""Innovations that are kept at a time."""
_SENSOR_OF_CHANNEL = (
    "wheel_speed",
    "wheel_speed",
    "yaw_rate",
    "lateral_acceleration",
    "longitudinal_acceleration",
    "steering",
    "side_slip",
)


class Likelihood(NamedTuple):
    """Negative logarithm of the likelihood; gradient (p,) and information (p, p) in spreads.

    The information of a delay is that of a smooth curve through the readings; the second
    derivatives by delays, `bends` (p,), have their roughness too, and are 0 for all else. `nis` is
    the mean of the innovations squared per degree of freedom, `freedoms` their number.
    """

    value: float
    gradient: np.ndarray
    information: np.ndarray
    bends: np.ndarray
    nis: float
    freedoms: int


@dataclass(frozen=True, eq=False)
class LoggedReadings:
    """A drive as the filter takes it.

    Attributes:
        readings: (samples, m), as logged, of the m channels that the log has; NaN for nothing.
        channels: (m,), which ones they are.
        counted: (samples,), whether innovations count: the car is fast enough.
        at: (samples,), the step of a run next to each sample.
        prior_mean: (6,).
        sample_s, time_step_s: of the log, and of a run.
    """

    readings: np.ndarray
    channels: tuple[int, ...]
    counted: np.ndarray
    at: np.ndarray
    prior_mean: np.ndarray
    sample_s: float
    time_step_s: float

    @property
    def sensors(self) -> tuple[str, ...]:
        """The sensor of each channel."""
        return tuple(_SENSOR_OF_CHANNEL[channel] for channel in self.channels)


def logged_readings(
    drive: Drive, car: Car, time_step_s: float, min_speed_m_s: float
) -> LoggedReadings:
    """The readings of a drive; the car says which wheels are not driven."""
    free = REAR_LEFT if car.driven_axle == "front" else FRONT_LEFT
    every = np.column_stack(
        [
            drive.wheel_speed_m_s[:, free : free + 2],
            drive.yaw_rate_rad_s,
            drive.lateral_acceleration_m_s2,
            drive.longitudinal_acceleration_m_s2,
            drive.steering_rad,
            drive.side_slip_rad,
        ]
    )
    start = [drive.yaw_rate_rad_s[0], 0.0, drive.speed_m_s[0], 0.0, drive.steering_rad[0], 0.0]
    there = np.flatnonzero(np.isfinite(every).any(axis=0))
    return LoggedReadings(
        every[:, there],
        tuple(there.tolist()),
        (np.nan_to_num(drive.speed_m_s) >= min_speed_m_s)
        & (np.minimum(drive.time_s, drive.time_s[-1] - drive.time_s) >= ENDS_S),
        np.round(drive.time_s / time_step_s).astype(int),
        np.nan_to_num(start),
        drive.time_step_s,
        time_step_s,
    )


def likelihood(
    log: LoggedReadings, car: Car, tyre: Tyre, sought: tuple[Sought, ...], spreads: np.ndarray
) -> Likelihood:
    """The likelihood of a log for a car whose parameters are so many spreads (p,) from its file.

    Delays count as the whole samples next to them, which is exact: the readings move by so many.
    """
    lanes = _Lanes.of(sought, log.sample_s)
    moved = spreads + lanes.moved
    filtered = _Filter(log, car, car_with(car, sought, moved), tyre, len(moved))
    totals = _Sums(lanes)
    for innovation, cov in filtered.blocks():
        totals.add(innovation, cov)
    return totals.likelihood()


class _Lanes(NamedTuple):
    """Lanes of one batch: lane 0 has the parameters themselves, lane 1 + i parameter i moved by
    little. In the last lanes the readings of one sensor, of those with `delays` (q,), are a sample
    earlier, then later.

    `moved` is (1 + p + 2 q, p), in spreads; `samples` (q,) are the lengths of a sample.
    """

    moved: np.ndarray
    delays: np.ndarray
    samples: np.ndarray

    @classmethod
    def of(cls, sought: tuple[Sought, ...], sample_s: float) -> "_Lanes":
        delays = np.flatnonzero([one.is_delay for one in sought])
        samples = np.array([sample_s / sought[place].spread for place in delays])
        each = np.eye(len(sought))
        by_sample = samples[:, None] * each[delays]
        little = DIFFERENCE * each
        return cls(np.concatenate([0 * each[:1], little, by_sample, -by_sample]), delays, samples)

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """Derivatives (B, p, ...) of the values (B, 1 + p + 2 q, ...) of all lanes."""
        count = self.moved.shape[1]
        return (values[:, 1 : 1 + count] - values[:, :1]) / DIFFERENCE


class _Sums:
    """The sums over the innovations of a drive."""

    def __init__(self, lanes: _Lanes) -> None:
        count = lanes.moved.shape[1]
        self._lanes, self._squares, self._freedoms = lanes, 0.0, 0
        self._gradient, self._information = np.zeros(count), np.zeros((count, count))
        self._values = np.zeros(len(lanes.moved))

    def add(self, innovation: np.ndarray, cov: np.ndarray) -> None:
        """Add innovations (B, lanes, m) with covariances (B, lanes, m, m), NaN for none."""
        missing = np.isnan(innovation)
        either = missing[..., :, None] | missing[..., None, :]
        v = np.where(missing, 0.0, innovation)
        s = np.where(either, np.eye(v.shape[-1]), cov)
        dv, ds = self._lanes.slopes(v), self._lanes.slopes(s)
        inverse = np.linalg.inv(s[:, 0])
        weighted = np.einsum("bij,bj->bi", inverse, v[:, 0])
        turned = np.einsum("bij,bpjk->bpik", inverse, ds)
        self._gradient += 0.5 * np.einsum("bpii->p", turned) + np.einsum("bi,bpi->p", weighted, dv)
        self._gradient -= 0.5 * np.einsum(
            "bi,bpi->p", weighted, np.einsum("bpij,bj->bpi", ds, weighted)
        )
        self._information += 0.5 * np.tensordot(turned, turned.mT, ((0, 2, 3), (0, 2, 3)))
        of_dv = np.einsum("bij,bpj->bpi", inverse, dv)
        self._information += np.tensordot(dv, of_dv, ((0, 2), (0, 2)))
        squares = np.einsum("bli,bli->l", v, np.linalg.solve(s, v[..., None])[..., 0])
        self._values += 0.5 * (np.linalg.slogdet(s)[1].sum(axis=0) + squares)
        self._squares += float(squares[0])
        self._freedoms += int(np.logical_not(missing[:, 0]).sum())

    def likelihood(self) -> Likelihood:
        """The sums; derivatives by delays are differences of the likelihood itself."""
        lanes, gradient, count = self._lanes, self._gradient, len(self._gradient)
        middle, (ahead, back) = self._values[0], np.split(self._values[1 + count :], 2)
        bends = np.zeros(count)
        gradient[lanes.delays] = (ahead - back) / (2 * lanes.samples)
        bends[lanes.delays] = (ahead + back - 2 * middle) / lanes.samples**2
        nis = self._squares / self._freedoms
        return Likelihood(float(middle), gradient, self._information, bends, nis, self._freedoms)


class _Filter:
    """The filter of many lanes of cars over one log."""

    def __init__(
        self, log: LoggedReadings, before: Car, lanes: Car, tyre: Tyre, count: int
    ) -> None:
        self._log, self._count, self._sheets = log, count, lanes.sensors
        track = SingleTrack(lanes, axles_of(lanes), tyre, log.time_step_s)
        self._model = DrivenCar(track)
        self._noise_cov = process_noise_covs(lanes.process_noise, log.time_step_s)
        self._noise_cov = np.broadcast_to(self._noise_cov, (count, 6, 6))
        self._sensors = [sensor(node, track) for node in range(3)]
        # The log was read with the ratio of the file.
        self._gain = lanes.steering_ratio / before.steering_ratio
        sheets = [getattr(lanes.sensors, name) for name in log.sensors]
        noise = np.stack([np.broadcast_to(sheet.noise, count) for sheet in sheets], axis=-1)
        self._reading_cov = np.square(noise)[..., None] * np.eye(len(sheets))

    def blocks(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Innovations (B, lanes, m) that count, and their covariances, block by block."""
        log, rule = self._log, scaled_unscented(6)
        transition = partial(self._model.transition, control=None, step=0)
        belief = Gaussian(
            np.broadcast_to(log.prior_mean, (self._count, 6)),
            np.broadcast_to(np.diag(np.square(PRIOR_STD)), (self._count, 6, 6)),
        )
        readings, kept, now = self._readings(), [], 0
        for at, reading, counts in zip(log.at, readings, log.counted, strict=True):
            for _ in range(at - now):
                belief = predict(belief, transition, self._noise_cov, rule)
            now = at
            if np.isnan(reading).all():
                continue
            found = update(belief, reading, self._measure, self._reading_cov, rule)
            belief = found.belief
            if counts:
                kept.append((found.innovation, found.innovation_cov))
            if len(kept) == BLOCK_SAMPLES:
                yield _stacked(kept)
                kept = []
        if kept:
            yield _stacked(kept)

    def _readings(self) -> np.ndarray:
        """The readings (samples, lanes, m), moved by the delays of each lane."""
        log, columns = self._log, []
        for name, logged in zip(log.sensors, log.readings.T, strict=True):
            delays = np.broadcast_to(getattr(self._sheets, name).delay_s, self._count)
            samples, lanes = np.unique(delays / log.sample_s, return_inverse=True)
            moved = [earlier(logged, value) for value in samples]
            columns.append(np.stack(moved, axis=-1)[:, lanes])
        return np.stack(columns, axis=-1)

    def _measure(self, state: np.ndarray) -> np.ndarray:
        """The channels (S, lanes, m) of states (S, lanes, 6)."""
        every = [one.measure(state, 0) for one in self._sensors]
        steering = self._sheets.steering.offset
        every[2][..., 0] = self._gain * (every[2][..., 0] - steering) + steering
        turning = self._sheets.slip_sensor_ahead_m * state[..., YAW_RATE]
        slip = np.arctan(np.tan(state[..., SIDE_SLIP]) + turning / np.maximum(state[..., SPEED], 1))
        slip += self._sheets.side_slip.offset
        stacked = np.concatenate([*every, slip[..., None]], axis=-1)
        return stacked[..., list(self._log.channels)]


def _stacked(kept: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    innovations, covs = zip(*kept, strict=True)
    return np.stack(innovations), np.stack(covs)
