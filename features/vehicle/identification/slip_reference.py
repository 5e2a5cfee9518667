"""The side slip of a drive from yaw rate and lateral acceleration, where no sensor logs it.

A filter that has no other sensor of the side slip takes errors of its tyres for side slip: the
lateral acceleration looks as if it told the slip to half a milliradian. The kinematics of a rigid
body hold without tyres: v_y' = a_y - r v_x. The smoother here integrates them. Of the tyres it
believes only that they err by `TYRE_ERROR` for `TYRE_ERROR_S`, and that their compliance is off by
an unknown factor. That ties the slow part down, which integration loses.

Beside a slip sensor the reference only tells whether the drive changes its side slip fast enough.
Then tyres that fit the drive badly do not count as a slow drive.

Source: Farrelly and Wellstead (1996), Estimation of vehicle lateral velocity, for the two models.
"""

from collections.abc import Mapping
from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.corrections import corrected, stamped, with_true_wheels
from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.drive_log import even_drive
from concord.features.vehicle.plant.model import MIN_SPEED_M_S, Tyre, single_track
from concord.features.vehicle.plant.parameters import Car
from concord.features.vehicle.plant.tyre_identification import (
    MODEL_STEP_S,
    Identified,
    longest_part,
)
from concord.filters.filter import Affine
from concord.filters.gaussian import Gaussian
from concord.filters.smoother import backward_affine, smooth
from concord.plants.recorded.channels import ChannelReadings, SamplingInstants, interpolated

TYRE_ERROR, TYRE_ERROR_S = 0.1, 0.5
"""Error of the tyres' side slip over that of the rear axle, and how long it lasts."""
_PRIOR_STD = (0.3, 0.3, 0.1, 0.3)
"""Of the state: lateral speed of the sensor m/s, offset of the lateral acceleration m/s², its
scale (the body rolls), and the compliance of the rear tyres over that of the car."""
_OFFSET_DRIFT_M_S2 = 0.003
"""That a second adds."""
_SCALE, _COMPLIANCE = 2, 3
_BLIND_M_S = 3.0
"""That a second adds to the lateral speed in a gap of the readings."""
_LEAST_READINGS = 100
_ROLL_LAG_S, _ROLL_LAG_STD_S = 0.08, 0.04
"""By which the roll of the body, and the part of gravity that the accelerometer then reads, follow
the lateral acceleration: of a damping of 0.45 at 1.8 Hz."""
_PLACE_M = 0.2
"""Standard deviation of the accelerometer's place in the file: load moves the centre of mass."""
_SPACING_S, _LEFT_OUT = 0.1, 0.1
"""Of the instants between which the errors of the reference are straight lines, and the share of
their variance that the modes leave out."""


class SlipReference(NamedTuple):
    """Side slip of the centre of mass.

    Attributes:
        readings: rad, at the instants of the smoother.
        std_rad: standard deviation (steps,).
        modes_rad: independent errors (modes, steps) of one standard deviation each. They last: the
            fit to the reference takes part of them for values of the car.
        told: standard deviation of the compliance of the rear tyres, over that of its prior. A
            drive that changes its side slip too slowly tells nothing: 1.
    """

    readings: ChannelReadings
    std_rad: np.ndarray
    modes_rad: np.ndarray
    told: float


def slip_reference(
    channels: Mapping[str, ChannelReadings], tyres: Identified, tyre: Tyre
) -> SlipReference | None:
    """Return the reference of a log; None where it has hardly any lateral acceleration.

    Args:
        channels: by the fields of `drive_log.ColumnMap`.
        tyres: of the car, as output error found them.
        tyre: law of the lateral force.
    """
    if "lateral_acceleration" not in channels:
        return None
    turning, accelerated = (channels[name] for name in ("yaw_rate", "lateral_acceleration"))
    if min(len(turning.values), len(accelerated.values)) < _LEAST_READINGS:
        return None
    sheets = tyres.car.sensors
    centred = corrected(channels, sheets).get("side_slip", ChannelReadings(*np.empty((2, 0))))
    channels = stamped(with_true_wheels(channels, sheets), sheets)
    start_s = min(one.stamps_s[0] for one in channels.values() if len(one.values))
    drive, after_s = longest_part(even_drive(channels, MODEL_STEP_S))
    times_s = start_s + after_s + drive.time_s
    turning, accelerated = (channels[name] for name in ("yaw_rate", "lateral_acceleration"))
    grid = SamplingInstants(times_s[0], drive.time_step_s, drive.steps)
    yaw_rate = interpolated(turning, grid) - sheets.yaw_rate.offset
    lateral = interpolated(accelerated, grid) - sheets.lateral_acceleration.offset
    known = np.isfinite(yaw_rate) & np.isfinite(lateral)
    yaw_rate, lateral = np.nan_to_num(yaw_rate), np.nan_to_num(lateral)
    speed = np.maximum(_smooth(drive.speed_m_s, drive.time_step_s), MIN_SPEED_M_S)
    slip, rear = _of_tyres(drive, yaw_rate, tyres, tyre)
    if logged := len(centred.values) > 0:
        at_rear = interpolated(centred, grid) - tyres.car.rear_axle_m * yaw_rate / speed
        rear = _smooth(np.where(np.isfinite(at_rear), at_rear, rear), drive.time_step_s)
    noise = np.hypot(_drift(accelerated), np.median(speed) * _drift(turning))
    drift = np.where(known, noise, _BLIND_M_S)
    arm = sheets.accelerometer_ahead_m * yaw_rate
    driven = _Driven(
        drive.time_step_s, drift, lateral, yaw_rate * speed, slip * speed + arm, rear * speed
    )
    believed = TYRE_ERROR * _rms(driven.rear)
    mean = _smoothed(driven, believed).states.mean
    left = _rms(driven.level - np.einsum("ki,ki->k", driven.rows, mean))
    found = _smoothed(driven, min(left, believed) if logged else left)
    mean, cov = found.states
    rolled = mean[:, _SCALE] * driven.lateral
    place, lag = _PLACE_M * yaw_rate, _ROLL_LAG_STD_S * rolled
    told = float(np.sqrt(cov[-1, _COMPLIANCE, _COMPLIANCE])) / _PRIOR_STD[_COMPLIANCE]
    return SlipReference(
        ChannelReadings(
            times_s[known],
            np.arctan((mean[:, 0] + _ROLL_LAG_S * rolled - arm) / speed)[known],
        ),
        (np.sqrt(cov[:, 0, 0]) / speed)[known],
        (np.stack([*_modes(found, drive.time_step_s), place, lag]) / speed)[:, known],
        told,
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _smooth(values: np.ndarray, time_step_s: float) -> np.ndarray:
    """The mean over a quarter of a second to either side."""
    half = round(0.25 / time_step_s)
    return np.convolve(np.pad(values, half, mode="edge"), np.ones(2 * half + 1), "valid") / (
        2 * half + 1
    )


def _drift(readings: ChannelReadings) -> float:
    """Return the growth of the integrated noise of a channel in a second, by third differences."""
    noise = np.sqrt(np.mean(np.square(np.diff(readings.values, 3))) / 20)
    return float(noise * np.sqrt(readings.spacing_s))


def _of_tyres(
    drive: Drive, yaw_rate: np.ndarray, tyres: Identified, tyre: Tyre
) -> tuple[np.ndarray, np.ndarray]:
    """Side slip (steps,) of the driven single-track model, and the slip angle of its rear axle."""
    car: Car = tyres.car
    track = single_track(car, tyre, drive.time_step_s)
    state = np.array([yaw_rate[0], 0.0, drive.speed_m_s[0]])
    found = np.empty((drive.steps, 2))
    driving = np.nan_to_num(drive.longitudinal_acceleration_m_s2)
    for k in range(drive.steps):
        state[2] = drive.speed_m_s[k]
        control = np.array([drive.steering_rad[k] + tyres.steering_offset_rad, driving[k]])
        found[k] = state[1], track.axle_slips(state, control[0])[1]
        state = track.transition(state, control, k)
    return found[:, 0], found[:, 1]


class _Driven(NamedTuple):
    """A drive as the smoother takes it.

    Attributes:
        time_step_s: between instants.
        drift: m/s (steps,) that a second adds to the lateral speed.
        lateral: acceleration (steps,) in m/s².
        turning: yaw rate times speed (steps,) in m/s².
        level: lateral speed (steps,) of the sensor in m/s, as the tyres have it.
        rear: slip angle of the rear axle times speed (steps,) in m/s.
    """

    time_step_s: float
    drift: np.ndarray
    lateral: np.ndarray
    turning: np.ndarray
    level: np.ndarray
    rear: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """Rows (steps, 4) that map a state to its level: the lag of the roll adds lateral speed."""
        one, lag = np.ones_like(self.rear), _ROLL_LAG_S * self.lateral
        return np.stack([one, 0 * one, lag, -self.rear], axis=-1)


class _Smoothed(NamedTuple):
    """States (steps, 4), and the gains (steps - 1, 4, 4) that lead back to them."""

    states: Gaussian
    gains: np.ndarray


def _smoothed(driven: _Driven, tyre_error: float) -> _Smoothed:
    """Smooth the states where the tyres' lateral speed errs by `tyre_error` m/s."""
    step = driven.time_step_s
    noise_cov = np.diag([0.0, step * _OFFSET_DRIFT_M_S2**2, 0.0, 0.0])
    variance = 2 * TYRE_ERROR_S / step * tyre_error**2
    belief = Gaussian(np.zeros(4), np.diag(np.square(_PRIOR_STD)))
    beliefs, ways, rows = [], [], driven.rows
    for k in range(len(driven.lateral)):
        if k:
            slope, before = np.eye(4), driven.lateral[k - 1]
            slope[0, 1], slope[0, 2] = -step, -step * before
            predicted = slope @ belief.mean
            predicted[0] += step * (before - driven.turning[k - 1])
            moved = Affine(predicted, slope, np.zeros((4, 4)))
            noise_cov[0, 0] = step * driven.drift[k - 1] ** 2
            ways.append(backward_affine(belief, moved, noise_cov))
            belief = ways[-1].predicted
        row = rows[k]
        gain = belief.cov @ row / (row @ belief.cov @ row + variance)
        less = np.eye(4) - np.outer(gain, row)
        cov = less @ belief.cov @ less.T + variance * np.outer(gain, gain)
        belief = Gaussian(belief.mean + gain * (driven.level[k] - row @ belief.mean), cov)
        beliefs.append(belief)
    history = Gaussian(*(np.stack(parts) for parts in zip(*beliefs, strict=True)))
    return _Smoothed(smooth(history, ways), np.stack([way.gain for way in ways]))


def _modes(found: _Smoothed, time_step_s: float) -> np.ndarray:
    """Return principal errors (modes, steps) of the smoothed lateral speed, in m/s.

    The covariance of two smoothed states is the product of the gains between them, times the
    covariance of the later one. Source: de Jong and MacKinnon (1988), Covariances for smoothed
    estimates in state space models, Biometrika 75(3).
    """
    steps = len(found.gains) + 1
    at = np.arange(0, steps, max(1, round(_SPACING_S / time_step_s)))
    between = [reduce(np.matmul, found.gains[k:m]) for k, m in pairwise(at)]
    cov = np.empty((len(at), len(at)))
    for last, step in enumerate(at):
        together = found.states.cov[step]
        cov[last, last] = together[0, 0]
        for place in range(last - 1, -1, -1):
            together = between[place] @ together
            cov[place, last] = cov[last, place] = together[0, 0]
    variances, shapes = np.linalg.eigh(cov)
    count = 1 + int(np.searchsorted(np.cumsum(variances[::-1]), (1 - _LEFT_OUT) * cov.trace()))
    modes = np.sqrt(variances[-count:]) * shapes[:, -count:]
    return np.stack([np.interp(np.arange(steps), at, mode) for mode in modes.T])
