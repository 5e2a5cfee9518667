"""Likelihood of the innovations of a drive, its gradient, and its Fisher information.

The innovations v with covariance S are those of the filter that hears every sensor of
`vehicle-network`, and the side slip where it is logged. With the negative logarithm
L = sum (log det S + v' S^-1 v) / 2 and derivatives v_i, S_i by parameter i:

    g_i  = sum tr(S^-1 S_i) / 2 + v' S^-1 v_i - v' S^-1 S_i S^-1 v / 2
    M_ij = sum tr(S^-1 S_i S^-1 S_j) / 2 + v_i' S^-1 v_j

Source: Gupta and Mehra (1974), Computational aspects of maximum likelihood estimation and reduction
in sensitivity function calculations. Derivatives are differences between lanes of one batch.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from concord.experiments.identification.scatter import scatter_of
from concord.experiments.identification.sought import Sought, car_with, process_noise_covs
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.filters.ukf import predict, update
from concord.plants.angles import wrapped
from concord.plants.recorded.channels import (
    ChannelReadings,
    interpolated,
    lateness_s,
    readings_by_step,
)
from concord.plants.vehicle.corrections import (
    SENSORS_OF_NODES,
    channels_of_nodes,
    earlier,
    earlier_by,
    stamped,
    steps_over,
)
from concord.plants.vehicle.drive_log import speeds_in
from concord.plants.vehicle.model import SingleTrack, Tyre, axles_of
from concord.plants.vehicle.network import (
    SIDE_SLIP,
    SPEED,
    YAW_RATE,
    DrivenCar,
    sensor,
)
from concord.plants.vehicle.parameters import Car
from concord.plants.vehicle.start import FirstBelief, start_of

DIFFERENCE = 1e-5
"""Of a parameter, in spreads."""
ENDS_S = 0.25
"""Innovations so near to the ends do not count: delays move readings across the ends."""
BLOCK_SAMPLES = 200
"""Innovations that are kept at a time."""
CORRELATED_S = 0.25
"""Scores that are so near count as correlated: the time in which errors of the model change."""
_WIDTHS, _RISE = (1, 2, 4, 8), 4.0
"""Samples over which differences by a delay may reach, and by how much the logarithm of the
likelihood must fall there on average: more than by the noise of readings that meet others."""
_SENSORS = (*(name for names in SENSORS_OF_NODES for name in names), "side_slip")
_COURSE = _SENSORS.index("course")


class Likelihood(NamedTuple):
    """Negative logarithm of the likelihood; gradient (p,) and information (p, p) in spreads.

    `scatter` (p, p) is the covariance of the gradient as the scores of the samples have it, and
    more, as they are few. Information is about equal to it where the model is right.

    The information of a delay is that of a smooth curve through the readings; the second
    derivatives by delays, `bends` (p,), have their roughness too, and are 0 for all else. `nis` is
    the mean of the innovations squared per degree of freedom, `freedoms` their number.
    """

    value: float
    gradient: np.ndarray
    information: np.ndarray
    bends: np.ndarray
    scatter: np.ndarray
    nis: float
    freedoms: int


@dataclass(frozen=True, eq=False)
class LoggedReadings:
    """A drive as the filter takes it.

    Attributes:
        readings: (steps, m), each at the step next to its stamp, NaN for nothing. A channel is
            there as often as a step has several readings of it.
        channels: (m,), which ones they are.
        counted: (steps,), whether the innovations of readings count: the car is fast enough.
        start: belief at the first step, of 6 states, or of 8 where positions are logged.
        time_step_s: of a run.
        car: of the file, with the delays with which readings came to their steps. A stamp between
            two steps counts as the nearer one, so they differ from those of the file by less.
    """

    readings: np.ndarray
    channels: tuple[int, ...]
    counted: np.ndarray
    start: FirstBelief
    time_step_s: float
    car: Car

    @property
    def sensors(self) -> tuple[str, ...]:
        """The sensor of each channel."""
        return tuple(_SENSORS[channel] for channel in self.channels)

    @property
    def positioned(self) -> bool:
        """Whether positions are among the readings."""
        return "position" in self.sensors


def logged_readings(
    channels: Mapping[str, ChannelReadings], car: Car, time_step_s: float, min_speed_m_s: float
) -> LoggedReadings:
    """The readings of a log, each once, at the steps at which a run has them.

    The car says which wheels are not driven, and by how much the stamps of sensors are late.
    """
    channels = stamped(channels, car.sensors)
    grid = steps_over(channels, time_step_s)
    names = (*(name for names in channels_of_nodes(car) for name in names), "side_slip")
    columns, there = [], []
    late_s: dict[str, list[float]] = {}
    for place, name in enumerate(names):
        if name in channels and len(channels[name].values):
            read = channels[name]
            if place == _COURSE:
                read = read._replace(values=np.unwrap(read.values))
            columns.append(readings_by_step(read, grid))
            there += [place] * columns[-1].shape[1]
            late_s.setdefault(_SENSORS[place], []).append(lateness_s(channels[name], grid))
    speed = np.mean([interpolated(channels[name], grid) for name in speeds_in(channels)], axis=0)
    since_s = time_step_s * np.arange(grid.steps)
    return LoggedReadings(
        np.concatenate(columns, axis=1),
        tuple(there),
        (np.nan_to_num(speed) >= min_speed_m_s)
        & (np.minimum(since_s, since_s[-1] - since_s) >= ENDS_S),
        start_of(channels, car.sensors),
        time_step_s,
        _as_read(car, {name: float(np.mean(each)) for name, each in late_s.items()}),
    )


def _as_read(car: Car, late_s: Mapping[str, float]) -> Car:
    """The car with the delays at which sensors were read, in the time of the steering."""
    zero_s, sheets = late_s.get("steering", 0.0), {}
    for name, late in late_s.items():
        sheet = getattr(car.sensors, name)
        sheets[name] = replace(sheet, delay_s=sheet.delay_s + late - zero_s)
    return replace(car, sensors=replace(car.sensors, **sheets))


def likelihood(
    log: LoggedReadings,
    tyre: Tyre,
    sought: tuple[Sought, ...],
    spreads: np.ndarray,
    widths: np.ndarray,
) -> Likelihood:
    """The likelihood of a log for parameters so many spreads (p,) from those of its car.

    Delays count as the whole samples next to them, which is exact: the readings move by so many.
    Differences by delays reach over `widths` (p,) samples (`widths_of`).
    """
    lanes = _Lanes.of(sought, log.time_step_s, widths)
    moved = spreads + lanes.moved
    filtered = _Filter(log, car_with(log.car, sought, moved), tyre, len(moved))
    totals = _Sums(lanes, round(CORRELATED_S / log.time_step_s))
    for innovation, cov in filtered.blocks():
        totals.add(innovation, cov)
    return totals.likelihood()


def widths_of(
    log: LoggedReadings, tyre: Tyre, sought: tuple[Sought, ...], spreads: np.ndarray
) -> np.ndarray:
    """Samples (p,) over which differences by delays show more than noise, 1 for all else, for
    parameters so many spreads (p,) from those of the log's car."""
    widths = np.ones(len(sought))
    lanes = _Lanes.of(sought, log.time_step_s, widths)
    ahead = lanes.moved[1 + len(sought) :][: len(lanes.delays)]
    each = [way * width * ahead for width in _WIDTHS for way in (1, -1)]
    moved = spreads + np.concatenate([lanes.moved[:1], *each])
    values = values_at(log, tyre, sought, moved)
    pairs = values[1:].reshape(len(_WIDTHS), 2, len(lanes.delays))
    enough = pairs.mean(axis=1) - values[0] > _RISE
    enough[-1] = True
    widths[lanes.delays] = np.array(_WIDTHS)[enough.argmax(axis=0)]
    return widths


def values_at(
    log: LoggedReadings, tyre: Tyre, sought: tuple[Sought, ...], spreads: np.ndarray
) -> np.ndarray:
    """The negative logarithm of the likelihood (lanes,) of cars so many spreads (lanes, p) away."""
    filtered = _Filter(log, car_with(log.car, sought, spreads), tyre, len(spreads))
    total = np.zeros(len(spreads))
    for innovation, cov in filtered.blocks():
        total += _terms(*_filled(innovation, cov))[0].sum(axis=0)
    return total


def judged(
    log: LoggedReadings, lanes: Car, tyre: Tyre, count: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Innovations (B, lanes, m) of a car of lanes, and their covariances, block by block."""
    return _Filter(log, lanes, tyre, count).blocks()


def squared(innovation: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """The normalised squares (...) of innovations (..., m); NaN entries were not taken."""
    return _terms(*_filled(innovation, cov))[1]


def _filled(innovation: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Innovations (..., m) and covariances with 0 and the identity for what was not taken."""
    missing = np.isnan(innovation)
    either = missing[..., :, None] | missing[..., None, :]
    return np.where(missing, 0.0, innovation), np.where(either, np.eye(missing.shape[-1]), cov)


def _terms(v: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Terms (...) of the negative logarithm of the likelihood, and squared innovations (...)."""
    squares = np.einsum("...i,...i->...", v, np.linalg.solve(s, v[..., None])[..., 0])
    return 0.5 * (np.linalg.slogdet(s)[1] + squares), squares


class _Lanes(NamedTuple):
    """Lanes of one batch: lane 0 has the parameters themselves, lane 1 + i parameter i moved by
    little. In the last lanes the readings of one sensor, of those with `delays` (q,), are some
    samples earlier, then later.

    `moved` is (1 + p + 2 q, p), in spreads; `reaches` (q,) are the lengths of so many samples.
    """

    moved: np.ndarray
    delays: np.ndarray
    reaches: np.ndarray

    @classmethod
    def of(cls, sought: tuple[Sought, ...], sample_s: float, widths: np.ndarray) -> "_Lanes":
        delays = np.flatnonzero([one.is_delay for one in sought])
        reaches = np.array([widths[one] * sample_s / sought[one].spread for one in delays])
        each = np.eye(len(sought))
        ahead = reaches[:, None] * each[delays]
        return cls(
            np.concatenate([0 * each[:1], DIFFERENCE * each, ahead, -ahead]), delays, reaches
        )

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """Derivatives (B, p, ...) of the values (B, 1 + p + 2 q, ...) of all lanes."""
        count = self.moved.shape[1]
        return (values[:, 1 : 1 + count] - values[:, :1]) / DIFFERENCE


class _Sums:
    """The sums over the innovations of a drive."""

    def __init__(self, lanes: _Lanes, correlated: int) -> None:
        count = lanes.moved.shape[1]
        self._lanes, self._correlated = lanes, correlated
        self._squares, self._freedoms = 0.0, 0
        self._information = np.zeros((count, count))
        self._scores: list[np.ndarray] = []
        self._values = np.zeros(len(lanes.moved))

    def add(self, innovation: np.ndarray, cov: np.ndarray) -> None:
        """Add innovations (B, lanes, m) with covariances (B, lanes, m, m), NaN for none."""
        v, s = _filled(innovation, cov)
        dv, ds = self._lanes.slopes(v), self._lanes.slopes(s)
        inverse = np.linalg.inv(s[:, 0])
        weighted = np.einsum("bij,bj->bi", inverse, v[:, 0])
        turned = np.einsum("bij,bpjk->bpik", inverse, ds)
        scores = 0.5 * np.einsum("bpii->bp", turned) + np.einsum("bi,bpi->bp", weighted, dv)
        scores -= 0.5 * np.einsum("bi,bpi->bp", weighted, np.einsum("bpij,bj->bpi", ds, weighted))
        self._information += 0.5 * np.tensordot(turned, turned.mT, ((0, 2, 3), (0, 2, 3)))
        of_dv = np.einsum("bij,bpj->bpi", inverse, dv)
        self._information += np.tensordot(dv, of_dv, ((0, 2), (0, 2)))
        values, squares = _terms(v, s)
        ahead, back = np.split(values[:, 1 + scores.shape[1] :], 2, axis=1)
        scores[:, self._lanes.delays] = (ahead - back) / (2 * self._lanes.reaches)
        self._scores.append(scores)
        self._values += values.sum(axis=0)
        self._squares += float(squares[:, 0].sum())
        self._freedoms += int(np.isfinite(innovation[:, 0]).sum())

    def likelihood(self) -> Likelihood:
        """The sums; derivatives by delays are differences of the likelihood itself."""
        lanes, count = self._lanes, self._lanes.moved.shape[1]
        scores = np.concatenate(self._scores)
        middle, (ahead, back) = self._values[0], np.split(self._values[1 + count :], 2)
        bends = np.zeros(count)
        bends[lanes.delays] = (ahead + back - 2 * middle) / lanes.reaches**2
        return Likelihood(
            float(middle),
            scores.sum(axis=0),
            self._information,
            bends,
            scatter_of(scores, self._correlated),
            self._squares / self._freedoms,
            self._freedoms,
        )


class _Filter:
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
        every = enumerate(_SENSORS)
        measured = [place for place, name in every if log.positioned or name != "position"]
        self._places = [measured.index(channel) for channel in log.channels]
        # The log was read with the ratio of the file.
        self._gain = lanes.steering_ratio / log.car.steering_ratio
        sheets = [getattr(lanes.sensors, name) for name in log.sensors]
        noise = np.stack([np.broadcast_to(sheet.noise, count) for sheet in sheets], axis=-1)
        self._reading_cov = np.square(noise)[..., None] * np.eye(len(sheets))

    def blocks(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Innovations (B, lanes, m) that count, and their covariances, block by block."""
        log, n, rule = self._log, self._states, scaled_unscented(self._states)
        transition = partial(self._model.transition, control=None, step=0)
        belief = Gaussian(
            np.broadcast_to(log.start.mean, (self._count, n)),
            np.broadcast_to(np.diag(np.square(log.start.std)), (self._count, n, n)),
        )
        kept = []
        for step, (reading, counts) in enumerate(zip(*self._readings(), strict=True)):
            if step:
                belief = predict(belief, transition, self._noise_cov, rule)
            if np.isnan(reading).all():
                continue
            found = update(
                belief, reading, self._measure, self._reading_cov, rule, residual=self._residual
            )
            belief = found.belief
            if counts.any():
                kept.append((np.where(counts, found.innovation, np.nan), found.innovation_cov))
            if len(kept) == BLOCK_SAMPLES:
                yield _stacked(kept)
                kept = []
        if kept:
            yield _stacked(kept)

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
        turning = self._sheets.slip_sensor_ahead_m * state[..., YAW_RATE]
        slip = np.arctan(np.tan(state[..., SIDE_SLIP]) + turning / np.maximum(state[..., SPEED], 1))
        slip += self._sheets.side_slip.offset
        stacked = np.concatenate([*every, slip[..., None]], axis=-1)
        return stacked[..., self._places]

    def _residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (..., m), a course within (-pi, pi]."""
        difference = a - b
        for place in np.flatnonzero(np.equal(self._log.channels, _COURSE)):
            difference[..., place] = wrapped(difference[..., place])
        return difference


def _stacked(kept: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    innovations, covs = zip(*kept, strict=True)
    return np.stack(innovations), np.stack(covs)
