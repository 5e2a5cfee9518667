"""Cornering stiffness of a car's axles from one of its drives, by output error.

The steering and the speed of the log drive the single-track model. The fit varies the stiffnesses,
and the friction for a tyre that saturates. It minimises the squared errors of yaw rate, lateral
acceleration and, where it is known, side slip. The fit also estimates constant offsets of steering,
lateral acceleration and side slip, because every log has them. It assumes a zeroed gyroscope, as
cars zero theirs at standstill; the steering's offset could not otherwise be separated from the
gyroscope's.

Source: Ljung (1999), System identification, chapter 7 (prediction-error methods; with no noise
model, output error). Standard errors are those of least squares with white residuals; residuals of
a drive are not white but model error, so the true errors are larger.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.model import Axles, SingleTrack, Tyre, tanh_tyre
from concord.features.vehicle.plant.parameters import Car
from concord.features.vehicle.plant.validity import SLOWEST_M_S

MODEL_STEP_S = 0.005
"""Of the model; drives are interpolated to it, for slow cars are stiff."""

ModelOfDrive = Callable[[Car, Axles, Tyre, float], SingleTrack]

_SCALES = (0.01, 0.2, 0.002)
"""Of the residuals: yaw rate rad/s, lateral acceleration m/s², side slip rad."""

LEAST_CORNERING_M_S2 = 1.5
"""Of a drive that tells something of the tyres."""

_STEP = 1e-4  # of the finite differences, in the logarithm of a parameter or in units of a scale


class Identified(NamedTuple):
    """Parameters of a car, identified from a drive.

    Attributes:
        car: with the stiffnesses found (and friction, if it was sought).
        stiffness_std_n_rad: standard errors (2,) of front and rear; NaN in a drive without fast
            curves, which leaves the tyres of the car.
        friction_std: that of the friction, NaN if it was not sought.
        steering_offset_rad: to be added to the logged steering.
        residual_rms: of yaw rate rad/s, lateral acceleration m/s² and side slip rad, NaN where
            nothing was logged.
        condition: of the scaled problem; above some 1e3 the drive says too little.
        part_s: start and end of the part of the drive that was fitted.
        cornering_m_s2: largest product of yaw rate and speed there.
    """

    car: Car
    stiffness_std_n_rad: np.ndarray
    friction_std: float
    steering_offset_rad: float
    residual_rms: np.ndarray
    condition: float
    part_s: tuple[float, float]
    cornering_m_s2: float


def identify(
    drive: Drive,
    car: Car,
    tyre: Tyre = tanh_tyre,
    *,
    seek_friction: bool = False,
    min_speed_m_s: float = SLOWEST_M_S,
    model: ModelOfDrive = SingleTrack,
) -> Identified:
    """Return the tyres of a car that fit a drive best, starting from the car's own.

    Args:
        drive: its longest part in which steering and speed are known is fitted.
        car: mass, geometry, and the tyres to start from.
        tyre: law of the lateral force.
        seek_friction: whether the friction is sought too; only a drive near the limit tells it.
        min_speed_m_s: slower parts are driven through and not compared; there wheels roll where
            they point, whatever their stiffness.
        model: makes the model of car, axles, tyre and sampling time.

    Raises:
        ValueError: a drive that is too short, or never fast enough.
    """
    from scipy.optimize import least_squares  # here, so that a node process never loads scipy

    driven, start_s = longest_part(_resampled(drive))
    outputs = np.stack(
        [driven.yaw_rate_rad_s, driven.lateral_acceleration_m_s2, driven.side_slip_rad], axis=-1
    )
    compared = np.isfinite(outputs) & (driven.speed_m_s >= min_speed_m_s)[:, None]
    _require_told(driven, compared[:, 0], min_speed_m_s)
    cornering_m_s2 = float(np.abs(driven.yaw_rate_rad_s * driven.speed_m_s)[compared[:, 0]].max())
    curves = cornering_m_s2 >= LEAST_CORNERING_M_S2
    # The fit has no offset for an output that was not logged.
    logged = np.any(compared[:, 1:], axis=0)
    sought = np.concatenate(([curves, curves, True], logged, [seek_friction and curves]))

    def made(axles: Axles) -> SingleTrack:
        return model(car, axles, tyre, driven.time_step_s)

    def residuals(parameters: np.ndarray) -> np.ndarray:
        """Scaled residuals (lanes, values) of the parameters sought (lanes, p)."""
        complete = np.zeros((len(parameters), len(sought)))
        complete[:, sought] = parameters
        left = (_outputs(driven, car, made, complete) - outputs[:, None, :]) / np.array(_SCALES)
        return np.moveaxis(left, 1, 0)[:, compared]

    def jacobian(parameters: np.ndarray) -> np.ndarray:
        steps = _STEP * np.eye(len(parameters))
        both = residuals(np.concatenate([parameters + steps, parameters - steps]))
        return ((both[: len(steps)] - both[len(steps) :]) / (2 * _STEP)).T

    jac: Any = jacobian  # scipy's types know the names of methods only
    start = np.zeros(len(sought))
    start[_STEERING_OFFSET] = _rolling_offset_rad(driven, car, compared[:, 0]) / _OFFSETS[0]
    found = least_squares(lambda p: residuals(p[None])[0], start[sought], jac=jac)
    part = start_s, start_s + driven.time_step_s * driven.steps, cornering_m_s2
    return _identified(car, sought, found, compared, part)


# Parameters: log of front and rear stiffness over the car's; offsets of steering, lateral
# acceleration and side slip in units of _OFFSETS; log of the friction over the car's.
_OFFSETS = np.array([1e-3, *_SCALES[1:]])
_FRONT, _REAR, _STEERING_OFFSET, _FRICTION = 0, 1, 2, 5


def _rolling_offset_rad(driven: Drive, car: Car, compared: np.ndarray) -> float:
    """Return the median of what the logged steering lacks where wheels roll where they point.

    A fit that starts far from a large offset ends at tyres that do not steer.
    """
    rolling = np.arctan2(car.wheelbase_m * driven.yaw_rate_rad_s, driven.speed_m_s)
    return float(np.median((rolling - driven.steering_rad)[compared]))


def _outputs(
    driven: Drive, car: Car, made: Callable[[Axles], SingleTrack], parameters: np.ndarray
) -> np.ndarray:
    """Yaw rate, lateral acceleration and side slip (steps, lanes, 3) of the model."""
    limit = car.friction * np.exp(parameters[:, _FRICTION])
    axles = Axles(
        car.front_stiffness_n_rad * np.exp(parameters[:, _FRONT]),
        car.rear_stiffness_n_rad * np.exp(parameters[:, _REAR]),
        limit * car.front_load_n,
        limit * car.rear_load_n,
    )
    model = made(axles)
    steering_offset, *offsets = (_OFFSETS * parameters[:, _STEERING_OFFSET:_FRICTION]).T
    state = np.zeros((len(parameters), 3))
    state[:, 0] = np.nan_to_num(driven.yaw_rate_rad_s[0])
    control = np.zeros((len(parameters), 2))
    driving = np.nan_to_num(driven.longitudinal_acceleration_m_s2)
    predicted = np.empty((driven.steps, len(parameters), 3))
    for k, speed in enumerate(driven.speed_m_s):
        state[:, 2] = speed  # as logged: only the lateral motion is compared
        control[:, 0] = driven.steering_rad[k] + steering_offset
        control[:, 1] = driving[k]
        predicted[k, :, 0] = state[:, 0]
        predicted[k, :, 1] = model.accelerations(state, control)[0]
        predicted[k, :, 2] = state[:, 1]
        state = model.transition(state, control, k)
    predicted[..., 1:] += np.stack(offsets, axis=-1)
    return predicted


def _identified(
    car: Car,
    sought: np.ndarray,
    found: Any,  # scipy's OptimizeResult
    compared: np.ndarray,
    part: tuple[float, float, float],
) -> Identified:
    residuals, jacobian = found.fun, found.jac
    values, std = np.zeros(len(sought)), np.full(len(sought), np.nan)
    values[sought] = found.x
    degrees = max(1, len(residuals) - len(found.x))
    cov = np.linalg.pinv(jacobian.T @ jacobian) * (residuals @ residuals) / degrees
    std[sought] = np.sqrt(cov.diagonal())
    front = float(car.front_stiffness_n_rad * np.exp(values[_FRONT]))
    rear = float(car.rear_stiffness_n_rad * np.exp(values[_REAR]))
    friction = float(car.friction * np.exp(values[_FRICTION]))
    squared = np.zeros(compared.shape)
    squared[compared] = residuals**2
    count = compared.sum(axis=0)
    mean_squared = squared.sum(axis=0) / np.where(count > 0, count, np.nan)
    return Identified(
        car=structs.replace(
            car, front_stiffness_n_rad=front, rear_stiffness_n_rad=rear, friction=friction
        ),
        stiffness_std_n_rad=np.array([front, rear]) * std[[_FRONT, _REAR]],
        friction_std=friction * float(std[_FRICTION]),
        steering_offset_rad=float(_OFFSETS[0] * values[_STEERING_OFFSET]),
        residual_rms=np.sqrt(mean_squared) * np.array(_SCALES),
        condition=float(np.linalg.cond(jacobian / np.linalg.norm(jacobian, axis=0))),
        part_s=part[:2],
        cornering_m_s2=part[2],
    )


def _resampled(drive: Drive) -> Drive:
    """Return the drive at the model's step, what is not known of it still NaN."""
    if drive.time_step_s <= MODEL_STEP_S:
        return drive
    time_s = MODEL_STEP_S * np.arange(round((drive.steps - 1) * drive.time_step_s / MODEL_STEP_S))

    def at(values: np.ndarray) -> np.ndarray:
        if values.ndim == 2:
            return np.stack([at(column) for column in values.T], axis=-1)
        return np.interp(time_s, drive.time_s, values)

    return Drive(MODEL_STEP_S, *(at(values) for values in drive[1:]))


def longest_part(drive: Drive) -> tuple[Drive, float]:
    """The longest part of a drive in which steering and speed are known, and its start in s."""
    told = np.isfinite(drive.steering_rad) & np.isfinite(drive.speed_m_s)
    edges = np.flatnonzero(np.diff(told, prepend=False, append=False)).reshape(-1, 2)
    if not len(edges):
        return drive, 0.0
    first, end = edges[np.diff(edges).argmax()].tolist()
    part = Drive(drive.time_step_s, *(values[first:end] for values in drive[1:]))
    return part, first * drive.time_step_s


def _require_told(driven: Drive, compared: np.ndarray, min_speed_m_s: float) -> None:
    if compared.sum() < 100:
        raise ValueError(
            f"the drive has {int(compared.sum())} yaw rates at {min_speed_m_s:g} m/s or more in "
            f"{driven.steps} samples in a row with steering and speed; give at least half a second "
            "of them"
        )
