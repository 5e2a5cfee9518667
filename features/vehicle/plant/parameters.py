"""A car as the single-track model sees it, from a TOML file or one of those known here."""

import json
import math
import tomllib
from collections.abc import Iterator
from typing import Any, Literal

import msgspec

GRAVITY_M_S2 = 9.81


class CarError(ValueError):
    """Parameters that no car can have, or a file that holds none."""


def _require_positive(what: str, values: msgspec.Struct, signed: tuple[str, ...] = ()) -> None:
    for field, value in msgspec.structs.asdict(values).items():
        if not isinstance(value, float | int):
            continue
        if field in signed and not math.isfinite(value):
            raise CarError(f"{what}: {field} is {value}, but must be finite")
        if field not in signed and not 0 < value < math.inf:
            raise CarError(f"{what}: {field} is {value}, but must be above 0 and finite")


class ProcessNoise(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Motion that the single-track model does not know: standard deviations that a second adds.

    They grow with the square root of time. Steering and acceleration are random walks in the
    filters, as only their sensors know them. Raises CarError for a value that is not positive.
    """

    yaw_rate_rad_s: float = (1e-5 / 0.005) ** 0.5
    side_slip_rad: float = (5e-7 / 0.005) ** 0.5
    speed_m_s: float = (1e-7 / 0.005) ** 0.5
    heading_rad: float = (1e-10 / 0.005) ** 0.5
    steering_rad: float = 0.0015 / 0.005**0.5
    acceleration_m_s2: float = 0.02 / 0.005**0.5
    position_m: float = 0.01

    def __post_init__(self) -> None:
        _require_positive("process_noise", self)

    @property
    def std(self) -> tuple[float, ...]:
        """Of [yaw rate, side slip, speed, heading, steering, acceleration, x, y]."""
        every = msgspec.structs.astuple(self)
        return (*every, every[-1])


class SensorSheet(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A sensor as filters believe in it, in SI units.

    Attributes:
        noise: standard deviation of a reading.
        offset: what a reading is too large by.
        delay_s: how much later than the motion a reading is stamped.

    Raises CarError for noise that is not positive, and for a value that is not finite.
    """

    noise: float
    offset: float = 0.0
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        _require_positive("sensors", self, signed=("offset", "delay_s"))


_PLACES = ("accelerometer_ahead_m", "slip_sensor_ahead_m", "antenna_ahead_m")


class SensorSheets(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The sensors of a car.

    The noise of the lateral acceleration covers the error of the single-track model as well. The
    side slip is that of an optical sensor, the truth for the errors of estimates.

    Attributes:
        accelerometer_ahead_m: of the centre of mass, along the car.
        slip_sensor_ahead_m, antenna_ahead_m: likewise of the optical sensor, and of the antenna
            for satellites.
        wheel_speed_scale: a logged wheel speed over the true one. It is the radius that the log
            was written with over the effective radius of the tyre.
        lateral_acceleration_scale: a logged lateral acceleration over the true one. A body that
            rolls in curves turns its accelerometer towards gravity: 1.05 for 3 degrees a g.
    """

    wheel_speed: SensorSheet = SensorSheet(noise=0.1)
    yaw_rate: SensorSheet = SensorSheet(noise=0.005)
    lateral_acceleration: SensorSheet = SensorSheet(noise=1.0)
    longitudinal_acceleration: SensorSheet = SensorSheet(noise=0.05)
    steering: SensorSheet = SensorSheet(noise=0.0005)
    ground_speed: SensorSheet = SensorSheet(noise=0.05)
    course: SensorSheet = SensorSheet(noise=0.003)
    position: SensorSheet = SensorSheet(noise=1.0)
    side_slip: SensorSheet = SensorSheet(noise=0.001)
    accelerometer_ahead_m: float = 0.0
    slip_sensor_ahead_m: float = 0.0
    antenna_ahead_m: float = 0.0
    wheel_speed_scale: float = 1.0
    lateral_acceleration_scale: float = 1.0

    def __post_init__(self) -> None:
        _require_positive("sensors", self, signed=_PLACES)


class Car(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Mass, geometry and tyres of one car, in ISO 8855 axes (x forward, y left, yaw to the left).

    Attributes:
        name: for reports.
        mass_kg, yaw_inertia_kg_m2: of the whole car.
        front_axle_m, rear_axle_m: from the centre of mass to either axle.
        front_stiffness_n_rad, rear_stiffness_n_rad: cornering stiffness of an axle, positive; the
            paper's k1 and k2 are these with a minus sign.
        friction: of tyre and road; where a tyre saturates.
        front_track_m, rear_track_m: between the wheels of an axle.
        driven_axle: front or rear; the wheels of the other tell the speed better.
        steering_ratio: steering-wheel angle over road-wheel angle.
        process_noise, sensors: of the filters that estimate the motion of this car.

    Raises CarError for a value that is not positive.
    """

    name: str
    mass_kg: float
    yaw_inertia_kg_m2: float
    front_axle_m: float
    rear_axle_m: float
    front_stiffness_n_rad: float
    rear_stiffness_n_rad: float
    friction: float = 1.0
    front_track_m: float = 1.5
    rear_track_m: float = 1.5
    driven_axle: Literal["front", "rear"] = "front"
    steering_ratio: float = 1.0
    process_noise: ProcessNoise = ProcessNoise()
    sensors: SensorSheets = SensorSheets()

    def __post_init__(self) -> None:
        _require_positive(f"car {self.name!r}", self)

    @property
    def wheelbase_m(self) -> float:
        return self.front_axle_m + self.rear_axle_m

    @property
    def front_load_n(self) -> float:
        """Weight on the front axle at rest."""
        return self.mass_kg * GRAVITY_M_S2 * self.rear_axle_m / self.wheelbase_m

    @property
    def rear_load_n(self) -> float:
        """Weight on the rear axle at rest."""
        return self.mass_kg * GRAVITY_M_S2 * self.front_axle_m / self.wheelbase_m


def car_from_toml(text: str) -> Car:
    """Return the car that a TOML text describes, one line per field.

    Raises:
        CarError: the text is not TOML, or a field is missing, unknown or out of range.
    """
    try:
        return msgspec.convert(tomllib.loads(text), Car)
    except tomllib.TOMLDecodeError as error:
        raise CarError(f"the car file is not TOML: {error}") from error
    except msgspec.ValidationError as error:
        raise CarError(f"the car file is not valid: {error}") from error


def car_to_toml(car: Car) -> str:
    """Return the TOML text of a car."""
    return "\n".join(_toml_lines(msgspec.to_builtins(car), "")) + "\n"


def _toml_lines(fields: dict[str, Any], table: str) -> Iterator[str]:
    """Lines of a table: its own values before the tables below it, as TOML demands."""
    for field, value in fields.items():
        if not isinstance(value, dict):
            # A JSON string without escapes of its own is a TOML string; names are printable text.
            is_text = isinstance(value, str)
            yield f"{field} = {json.dumps(value, ensure_ascii=False) if is_text else value}"
    for field, value in fields.items():
        if isinstance(value, dict):
            yield f"\n[{table}{field}]"
            yield from _toml_lines(value, f"{table}{field}.")


BMW_320I = Car(
    name="BMW 320i",
    mass_kg=1093.2952334674046,
    yaw_inertia_kg_m2=1791.5995300122856,
    front_axle_m=1.1561957064,
    rear_axle_m=1.4227170936,
    # 21.92 per rad times the load of the axle: the slope of the data sheet's tyre at no slip.
    front_stiffness_n_rad=129697.0,
    rear_stiffness_n_rad=105400.0,
    friction=1.0489,
    front_track_m=1.38684,
    rear_track_m=1.36398,
    driven_axle="rear",
)
"""Vehicle 2 of the CommonRoad vehicle models (Althoff and Wuersching, 2020, tables 6 and 7)."""
