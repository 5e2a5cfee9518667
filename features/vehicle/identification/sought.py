"""Parameters of a car that a drive can show, their priors, and lanes of cars.

A parameter is counted in spreads from its value in the file, by its logarithm where only its ratio
has a meaning. The spread is the standard deviation of a prior: what is believed before the drive.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from concord.features.vehicle.plant.corrections import channels_of_nodes
from concord.features.vehicle.plant.network import SENSORS_OF_NODES
from concord.features.vehicle.plant.parameters import Car, ProcessNoise
from concord.plants.recorded.channels import ChannelReadings

S = TypeVar("S", bound=msgspec.Struct)

SEEN = 0.5
"""Greatest deviation of a parameter that the drive tells, over that of its prior."""

_GEOMETRY = (
    ("front_stiffness_n_rad", "front stiffness", "N/rad", 0.5),
    ("rear_stiffness_n_rad", "rear stiffness", "N/rad", 0.5),
    ("yaw_inertia_kg_m2", "yaw inertia", "kg m²", 0.3),
)
_UNITS = {
    "wheel_speed": "m/s",
    "yaw_rate": "rad/s",
    "lateral_acceleration": "m/s²",
    "longitudinal_acceleration": "m/s²",
    "steering": "rad",
    "ground_speed": "m/s",
    "course": "rad",
    "position": "m",
    "side_slip": "rad",
}
_OFFSETS = {
    "yaw_rate": 0.05,
    "lateral_acceleration": 1.0,
    "longitudinal_acceleration": 1.0,
    "steering": 0.05,
    "side_slip": 0.05,
}
_SHARED_DELAYS = {
    "wheel speed": ("wheel_speed",),
    "inertial unit": ("yaw_rate", "lateral_acceleration", "longitudinal_acceleration"),
    "satellite receiver": ("ground_speed", "course", "position"),
    "side slip": ("side_slip",),
}
"""Sensors that share a delay."""
_ARM_M, _DELAY_S, _FRICTION, _RATIO, _NOISE, _PROCESS_NOISE = 1.0, 0.05, 0.3, 0.2, 1.5, 2.0
_SCALE = 0.05
_PROCESS = {
    "yaw_rate_rad_s": "rad/s/√s",
    "side_slip_rad": "rad/√s",
    "speed_m_s": "m/s/√s",
    "steering_rad": "rad/√s",
    "acceleration_m_s2": "m/s²/√s",
}


class Sought(NamedTuple):
    """A parameter of a car's file.

    Attributes:
        name: for reports.
        unit: of its value.
        path: fields that lead to it.
        spread: standard deviation of the prior, in the unit or of the logarithm.
        relative: whether the logarithm is counted.
        also: other fields that have the same value.
    """

    name: str
    unit: str
    path: tuple[str, ...]
    spread: float
    relative: bool
    also: tuple[tuple[str, ...], ...] = ()

    @property
    def is_noise(self) -> bool:
        """Whether it is a standard deviation, of which zero is as good as little."""
        return self.path[-1] == "noise" or self.path[0] == "process_noise"

    @property
    def is_delay(self) -> bool:
        """Whether it is the delay of a sensor."""
        return self.path[-1] == "delay_s"

    def value(self, start: float, spreads: Any) -> Any:
        """The value that is so many spreads from that of the file."""
        moved = self.spread * spreads
        return start * np.exp(moved) if self.relative else start + moved


def sought_of(
    channels: Mapping[str, ChannelReadings], car: Car, *, friction: bool, ratio: bool
) -> tuple[Sought, ...]:
    """The parameters that the sensors of a log could tell.

    The delay of the steering is that of the file, because only differences of delays
    show.
    """
    found = [Sought(name, unit, (field,), spread, True) for field, name, unit, spread in _GEOMETRY]
    if friction:
        found.append(Sought("friction", "", ("friction",), _FRICTION, True))
    if ratio:
        found.append(Sought("steering ratio", "", ("steering_ratio",), _RATIO, True))
    read = {name for name, readings in channels.items() if len(readings.values)}
    every = zip(
        (*sum(SENSORS_OF_NODES, ()), "side_slip"),
        (*sum(channels_of_nodes(car), ()), "side_slip"),
        strict=True,
    )
    sensors = list(dict.fromkeys(sensor for sensor, channel in every if channel in read))
    # At an even speed an antenna that is further ahead reads as one with less delay.
    arms = (("lateral_acceleration", "accelerometer"), ("side_slip", "slip sensor"))
    for sensor, name in arms:
        if sensor in sensors:
            path = ("sensors", f"{name.replace(' ', '_')}_ahead_m")
            found.append(Sought(f"{name} ahead of the centre", "m", path, _ARM_M, False))
    # Without a speed over ground, wheels that read too much look like a car that is faster.
    if "wheel_speed" in sensors and {"ground_speed", "position"} & set(sensors):
        path = ("sensors", "wheel_speed_scale")
        found.append(Sought("scale of wheel speed", "", path, _SCALE, True))
    if "lateral_acceleration" in sensors:
        path = ("sensors", "lateral_acceleration_scale")
        found.append(Sought("scale of lateral acceleration", "", path, _SCALE, True))
    for sensor in sensors:
        name, path, unit = sensor.replace("_", " "), ("sensors", sensor), _UNITS[sensor]
        found.append(Sought(f"noise of {name}", unit, (*path, "noise"), _NOISE, True))
        if sensor in _OFFSETS:
            offset = Sought(f"offset of {name}", unit, (*path, "offset"), _OFFSETS[sensor], False)
            found.append(offset)
    for name, together in _SHARED_DELAYS.items():
        there = [sensor for sensor in together if sensor in sensors]
        if there:
            path, *also = (("sensors", sensor, "delay_s") for sensor in there)
            found.append(Sought(f"delay of {name}", "s", path, _DELAY_S, False, tuple(also)))
    for field, unit in _PROCESS.items():
        name = field.partition("_rad")[0].partition("_m_")[0].replace("_", " ")
        path = ("process_noise", field)
        found.append(Sought(f"process noise of {name}", unit, path, _PROCESS_NOISE, True))
    return tuple(found)


def value_at(car: msgspec.Struct, path: Sequence[str]) -> float:
    """The value that the fields of a path lead to."""
    value: Any = car
    for field in path:
        value = getattr(value, field)
    return value


def with_value(owner: S, path: Sequence[str], value: Any) -> S:
    """The same with another value at the end of a path."""
    field, *below = path
    if below:
        value = with_value(getattr(owner, field), below, value)
    return msgspec.structs.replace(owner, **{field: value})


def car_with(car: Car, sought: Sequence[Sought], spreads: np.ndarray) -> Car:
    """The car whose parameters are so many spreads (..., p) from those of the file.

    Leading axes make the values arrays (...): a car of lanes, which the models take as any other.
    """
    for place, one in enumerate(sought):
        value = one.value(value_at(car, one.path), spreads[..., place])
        for path in (one.path, *one.also):
            car = with_value(car, path, value if spreads.ndim > 1 else float(value))
    return car


def told(every: tuple[Sought, ...], precision: np.ndarray) -> np.ndarray:
    """Which parameters (p,) of this precision (p, p) to keep, in spreads: the least known is left
    out first, as it may hide another."""
    kept = np.ones(len(every), dtype=bool)
    noise = np.array([one.is_noise for one in every])
    while kept.any():
        std = np.full(len(every), -np.inf)
        std[kept] = np.sqrt(np.diagonal(np.linalg.inv(precision[kept][:, kept])))
        std[noise] = -np.inf
        worst = int(np.argmax(std))
        if std[worst] <= SEEN:
            break
        kept[worst] = False
    return kept


def process_noise_covs(noise: ProcessNoise, time_step_s: float, states: int) -> np.ndarray:
    """Covariances (..., states, states) of a step, for values (...) of the noise."""
    std = np.stack(np.broadcast_arrays(*noise.std[:states]), axis=-1)
    return time_step_s * np.square(std)[..., None] * np.eye(std.shape[-1])
