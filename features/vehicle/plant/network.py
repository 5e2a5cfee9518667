"""A car whose sensors are nodes on its bus: wheel speeds, inertial unit, steering, satellites.

Every node estimates the whole motion, so that what one sensor lacks another can tell: state [yaw
rate, side slip, speed, heading, steering, acceleration]. Steering and acceleration, inputs of the
single-track model, are random walks here: only their sensors know them. Where a log has positions,
the state also has the place of the centre of mass, [x, y]; the heading counts from x to the left.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from concord.features.vehicle.plant.drive import FRONT_LEFT, REAR_LEFT, Drive
from concord.features.vehicle.plant.model import SingleTrack
from concord.features.vehicle.plant.parameters import Car, SensorSheet
from concord.features.vehicle.plant.sensors import SensorError, contaminated, noise_std
from concord.plants.placement import Draws, GeneratorFor
from concord.plants.range_bearing import wrapped
from concord.plants.recorded.channels import earlier

STATE_NAMES = ("yaw rate", "side slip", "speed", "heading", "steering", "acceleration")
STATE_UNITS = ("rad/s", "rad", "m/s", "rad", "rad", "m/s²")
YAW_RATE, SIDE_SLIP, SPEED, HEADING, STEERING, ACCELERATION = range(6)
PLACE = slice(6, 8)
PLACE_NAMES, PLACE_UNITS = ("x", "y"), ("m", "m")
"""Of the states that a log with positions adds."""

NODES = ("wheel speeds", "inertial unit", "steering", "satellites")
CHANNELS = 3
"""Of a reading, filled up with NaN: the inertial unit has most, unless positions are logged."""

SATELLITE_PERIOD_S = 0.1

PRIOR_STD = (0.02, 0.01, 0.5, 0.02, 0.01, 0.3)

ERRORS: tuple[tuple[SensorError, ...], ...] = (
    (SensorError(0.1), SensorError(0.1)),
    (SensorError(0.005), SensorError(0.1), SensorError(0.05)),
    (SensorError(0.0005),),
    (SensorError(0.05), SensorError(0.003)),
)
"""Data sheets of each node's channels, in SI: the two wheels that are not driven; yaw rate,
lateral and longitudinal acceleration; steering; speed and course over ground. A log may add the
position, x and y."""

CHANNEL_NAMES = (
    (("left wheel speed", "m/s"), ("right wheel speed", "m/s")),
    (
        ("yaw rate", "rad/s"),
        ("lateral acceleration", "m/s²"),
        ("longitudinal acceleration", "m/s²"),
    ),
    (("steering angle", "rad"),),
    (("speed over ground", "m/s"), ("course over ground", "rad"), ("x", "m"), ("y", "m")),
)
"""Name and unit of each node's channels."""


SENSORS_OF_NODES = (
    ("wheel_speed", "wheel_speed"),
    ("yaw_rate", "lateral_acceleration", "longitudinal_acceleration"),
    ("steering",),
    ("ground_speed", "course", "position", "position"),
)
"""The sensor of each of the nodes' channels, by its name in `SensorSheets`."""


@dataclass(frozen=True, eq=False)
class DrivenCar:
    """Model of every node: the single-track model, driven by the inputs that the node has.

    noise_factor: standard deviations of the process noise over those of the car's file.
    positioned: whether the state holds the place of the car.
    """

    single_track: SingleTrack
    noise_factor: float = 1.0
    positioned: bool = False

    @property
    def time_step_s(self) -> float:
        return self.single_track.time_step_s

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """State (..., 6) or (..., 8) one step later; nothing outside it drives the car."""
        after = np.empty_like(state)
        moving, inputs = state[..., :HEADING], state[..., STEERING : ACCELERATION + 1]
        after[..., :HEADING] = self.single_track.transition(moving, inputs, step)
        after[..., HEADING] = state[..., HEADING] + self.time_step_s * state[..., YAW_RATE]
        after[..., STEERING : ACCELERATION + 1] = inputs
        if self.positioned:
            course = state[..., HEADING] + state[..., SIDE_SLIP]
            way = self.time_step_s * state[..., SPEED] / np.cos(state[..., SIDE_SLIP])
            direction = np.stack([np.cos(course), np.sin(course)], axis=-1)
            after[..., PLACE] = state[..., PLACE] + way[..., None] * direction
        return after

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (n, n) of what a step does not know; the same at every step."""
        return self._noise_cov

    @cached_property
    def _noise_cov(self) -> np.ndarray:
        states = len(STATE_NAMES) + (len(PLACE_NAMES) if self.positioned else 0)
        std = self.noise_factor * np.array(self.single_track.car.process_noise.std[:states])
        return np.diag(self.time_step_s * np.square(std))


@dataclass(frozen=True, eq=False)
class CarSensor:
    """A node's sensor: `read` maps states (..., n) to its channels (..., m).

    sheets: of each channel, what the node believes at the start. course: the channel that is an
    angle. channels: name and unit of each. kinds: of which of `SensorSheets` each is.
    """

    read: Callable[[np.ndarray], np.ndarray]
    sheets: tuple[SensorSheet, ...]
    course: int | None = None
    gate: float | None = None
    channels: tuple[tuple[str, str], ...] = ()
    kinds: tuple[str, ...] = ()

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Channels (..., m) of states (..., n), without noise."""
        value = self.read(state)
        for channel, sheet in enumerate(self.sheets):
            value[..., channel] += sheet.offset
        return value

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (..., m), a course within (-pi, pi]."""
        difference = a - b
        if self.course is not None:
            difference[..., self.course] = wrapped(difference[..., self.course])
        return difference

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The node's channels (..., m) of a delivery (..., d), and their covariance (..., m, m)."""
        m = len(self.sheets)
        return delivered[..., :m], np.broadcast_to(self._noise_cov, (*delivered.shape[:-1], m, m))

    @cached_property
    def _noise_cov(self) -> np.ndarray:
        return np.diag([sheet.noise**2 for sheet in self.sheets])


def sensor(node: int, single_track: SingleTrack, positioned: bool = False) -> CarSensor:
    """Return the sensor of one of `NODES`; if `positioned`, satellites tell the place."""

    car, sheets = single_track.car, single_track.car.sensors
    scale = sheets.wheel_speed_scale

    def rear_wheels(state: np.ndarray) -> np.ndarray:
        side = 0.5 * car.rear_track_m * state[..., YAW_RATE]
        along = [scale * (state[..., SPEED] + way * side) for way in (-1.0, 1.0)]
        return np.stack(along, axis=-1)

    def front_wheels(state: np.ndarray) -> np.ndarray:
        side = 0.5 * car.front_track_m * state[..., YAW_RATE]
        across = state[..., SPEED] * np.tan(state[..., SIDE_SLIP])
        across = across + car.front_axle_m * state[..., YAW_RATE]
        cosine, sine = np.cos(state[..., STEERING]), np.sin(state[..., STEERING])
        along = [(state[..., SPEED] + way * side) * cosine + across * sine for way in (-1.0, 1.0)]
        return np.stack([scale * one for one in along], axis=-1)

    def inertial(state: np.ndarray) -> np.ndarray:
        ahead, yaw_rate = sheets.accelerometer_ahead_m, state[..., YAW_RATE]
        lateral, turning = single_track.accelerations(state, state[..., STEERING:])
        forward = state[..., ACCELERATION] - ahead * yaw_rate**2
        across = sheets.lateral_acceleration_scale * (lateral + ahead * turning)
        return np.stack([yaw_rate, across, forward], axis=-1)

    def steering(state: np.ndarray) -> np.ndarray:
        return state[..., STEERING : STEERING + 1].copy()

    def satellites(state: np.ndarray) -> np.ndarray:
        ahead, heading = sheets.antenna_ahead_m, state[..., HEADING]
        across = state[..., SPEED] * np.tan(state[..., SIDE_SLIP]) + ahead * state[..., YAW_RATE]
        course = heading + np.arctan2(across, state[..., SPEED])
        told = [np.hypot(state[..., SPEED], across), course]
        if positioned:
            told += [
                state[..., PLACE.start] + ahead * np.cos(heading),
                state[..., PLACE.start + 1] + ahead * np.sin(heading),
            ]
        return np.stack(told, axis=-1)

    free_wheels = rear_wheels if car.driven_axle == "front" else front_wheels
    read = (free_wheels, inertial, steering, satellites)[node]
    of_channels = (
        (sheets.wheel_speed, sheets.wheel_speed),
        (sheets.yaw_rate, sheets.lateral_acceleration, sheets.longitudinal_acceleration),
        (sheets.steering,),
        (sheets.ground_speed, sheets.course, *(2 * [sheets.position] if positioned else [])),
    )
    course, sheets_there = 1 if read is satellites else None, of_channels[node]
    names = CHANNEL_NAMES[node][: len(sheets_there)]
    kinds = SENSORS_OF_NODES[node][: len(sheets_there)]
    return CarSensor(read, sheets_there, course, channels=names, kinds=kinds)


@dataclass(frozen=True, eq=False)
class DrivenOnce:
    """A plant that replays a drive, one row of its arrays per step.

    Attributes:
        time_step_s: of the arrays.
        truth: (steps, n), NaN where it is unknown.
        exact: (steps, 4, r, d), up to r readings of a step as the sensors would deliver them
            without error, NaN for nothing.
        prior_mean: (n,), what the nodes start from, less the error of a run.
        errors: of each node's channels, on top of `exact`.
        prior_error: whether the start errs by `prior_std`; a log knows its own start.
        prior_std: (n,), what the nodes believe of the start.
    """

    time_step_s: float
    truth: np.ndarray
    exact: np.ndarray
    prior_mean: np.ndarray
    errors: tuple[tuple[SensorError, ...], ...]
    prior_error: bool = True
    prior_std: Sequence[float] | np.ndarray = PRIOR_STD

    @property
    def state_names(self) -> tuple[str, ...]:
        return (STATE_NAMES + PLACE_NAMES)[: len(self.prior_std)]

    @property
    def state_units(self) -> tuple[str, ...]:
        return (STATE_UNITS + PLACE_UNITS)[: len(self.prior_std)]

    @property
    def nodes(self) -> int:
        return len(NODES)

    @property
    def steps(self) -> int:
        """Return the number of instants there are."""
        return len(self.truth)

    def delayed(self, steps: Sequence[Sequence[int]]) -> "DrivenOnce":
        """The drive with readings of each node and channel so many steps earlier."""
        return replace(self, exact=earlier(self.exact, steps))

    def positions(self, step: int) -> None:
        """The nodes sit in one car: nothing to draw on a map."""

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run, outliers among it.

        Raises:
            ValueError: for more steps than there are.
        """
        if steps > self.steps:
            raise ValueError(
                f"{steps} steps, but the drive has {self.steps} of {1e3 * self.time_step_s:g} ms; "
                f"ask for {self.steps} or fewer"
            )
        measurement = np.zeros((steps, *self.exact.shape[1:]))
        for node, channels in enumerate(self.errors):
            generator = generator_for("measurement", node)
            for channel, error in enumerate(channels):
                drawn = contaminated(error, generator, (self.steps,))
                measurement[:, node, 0, channel] = drawn[:steps]
        initial = generator_for("initial", 0).standard_normal(len(self.prior_std))
        return Draws(initial, np.empty((steps, 0)), measurement)

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., n), prior mean (..., n) and prior cov (n, n) for noise (..., n)."""
        error = np.array(self.prior_std) * noise if self.prior_error else np.zeros_like(noise)
        truth = np.broadcast_to(self.truth[0], error.shape)
        return truth, self.prior_mean + error, np.diag(np.square(self.prior_std))

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """Return the state of the next step for states (..., n), NaN after the end."""
        after = self.truth[step + 1] if step + 1 < self.steps else np.nan
        return np.broadcast_to(after, state.shape)

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Return the sensors' readings at a step for noise (..., 4, r, d)."""
        return self.exact[step] + self._bias + self._std[step] * noise

    @cached_property
    def _std(self) -> np.ndarray:
        """(steps, 4, 1, d)."""
        time_s = self.time_step_s * np.arange(self.steps, dtype=np.float64)
        std = np.zeros((self.steps, self.nodes, 1, self.exact.shape[-1]))
        for node, channels in enumerate(self.errors):
            for channel, error in enumerate(channels):
                std[:, node, 0, channel] = noise_std(error, time_s)
        return std

    @cached_property
    def _bias(self) -> np.ndarray:
        bias = np.zeros((self.nodes, 1, self.exact.shape[-1]))
        for node, channels in enumerate(self.errors):
            bias[node, 0, : len(channels)] = [error.bias for error in channels]
        return bias


def simulated(
    drive: Drive, car: Car, errors: tuple[tuple[SensorError, ...], ...] = ERRORS
) -> DrivenOnce:
    """Return the plant of a drive whose truth is known, with sensors that err so."""
    truth = np.stack(
        [
            drive.yaw_rate_rad_s,
            drive.side_slip_rad,
            drive.speed_m_s,
            drive.heading_rad,
            drive.steering_rad,
            drive.longitudinal_acceleration_m_s2,
        ],
        axis=-1,
    )
    over_ground = np.hypot(drive.speed_m_s, drive.lateral_speed_m_s)
    exact = _readings(drive, car)
    due = np.arange(drive.steps) % round(SATELLITE_PERIOD_S / drive.time_step_s) == 0
    exact[due, 3, 0, 0] = over_ground[due]
    exact[due, 3, 0, 1] = (drive.heading_rad + drive.side_slip_rad)[due]
    return DrivenOnce(drive.time_step_s, truth, exact, truth[0], errors)


def _readings(drive: Drive, car: Car) -> np.ndarray:
    """Return the readings (steps, 4, 1, 3) of all sensors except satellite navigation."""
    readings = np.full((drive.steps, len(NODES), 1, CHANNELS), np.nan)
    free = REAR_LEFT if car.driven_axle == "front" else FRONT_LEFT
    readings[:, 0, 0, :2] = drive.wheel_speed_m_s[:, free : free + 2]
    readings[:, 1, 0, 0] = drive.yaw_rate_rad_s
    readings[:, 1, 0, 1] = drive.lateral_acceleration_m_s2
    readings[:, 1, 0, 2] = drive.longitudinal_acceleration_m_s2
    readings[:, 2, 0, 0] = drive.steering_rad
    return readings
