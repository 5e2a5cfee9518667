"""True drives, from the CommonRoad vehicle models: a car with 29 states, or one that drifts with 9.

They share nothing with the models in the filters, neither equations nor code. The library is not
needed to run concord, only to simulate cars: it is imported where it is used.

Source: Althoff and Wuersching (2020), CommonRoad: Vehicle models.
"""

import importlib.util
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.manoeuvres import CarMotion, Manoeuvre
from concord.features.vehicle.plant.parameters import GRAVITY_M_S2, Car

INTEGRATION_STEP_S = 1e-3
SPEED_GAIN_1_S = 1.0
"""How fast the driver corrects an error of speed."""


class SpunOut(ValueError):
    """The simulated car has left what its model can tell."""


@dataclass(frozen=True)
class TrueCar:
    """A car of the library: its number (1 Ford Escort, 2 BMW 320i, 3 VW Vanagon).

    `tyre_changes` replace fields of its tyre parameters, e.g. {"p_ky1": -12.0}.
    """

    name: str
    vehicle_id: int
    tyre_changes: Mapping[str, float] = field(default_factory=dict)


BMW = TrueCar("BMW 320i", 2)
SOFT_BMW = TrueCar(
    "BMW 320i on soft tyres",
    2,
    # Half the cornering stiffness; without the jump of the force where the camber changes sign.
    {"p_ky1": -12.0, "p_hy1": 0.0, "p_hy3": 0.0, "p_vy1": 0.0, "p_vy3": 0.0},
)
ESCORT = TrueCar("Ford Escort", 1)
VANAGON = TrueCar("VW Vanagon", 3)

TRUE_CARS = {
    "bmw-320i": BMW,
    "bmw-320i-soft": SOFT_BMW,
    "ford-escort": ESCORT,
    "vw-vanagon": VANAGON,
}
"""By the names of `vehicle_cars.FITTED_CARS`, which says what estimators believe of them."""


class Body(NamedTuple):
    """A model of the library, state (n,) as it orders it.

    Attributes:
        begin: (speed, parameters) -> state.
        derivative: (state, [steering rate, acceleration], parameters) -> its derivative.
        motion: state -> Motion.
        sample: (state, derivative, parameters) -> yaw rate, vx, vy, their derivatives, and the
            four wheels' circumference speeds.
    """

    begin: Callable[[float, Any], list[float]]
    derivative: Callable[[list[float], list[float], Any], list[float]]
    motion: Callable[[np.ndarray], CarMotion]
    sample: Callable[[np.ndarray, np.ndarray, Any], list[float]]


_STEERING, _HEADING = 2, 4  # in the states of the body


def simulate(
    manoeuvre: Manoeuvre,
    car: TrueCar,
    time_step_s: float,
    integration_step_s: float = INTEGRATION_STEP_S,
) -> Drive:
    """Return the true drive of a car through a manoeuvre.

    The classical Runge-Kutta method with the driver's commands held over each of its steps.

    Args:
        manoeuvre: who steers, how fast.
        car: which car.
        time_step_s: between samples of the drive; a multiple of the integration step.
        integration_step_s: of the method.

    Raises:
        ValueError: the library is not installed, or the steps do not fit each other.
        SpunOut: the car has spun, or has left what its model can tell.
    """
    every = round(time_step_s / integration_step_s)
    if every < 1 or abs(every * integration_step_s - time_step_s) > 1e-9:
        raise ValueError(
            f"time step {time_step_s:g} s: must be a multiple of the integration step "
            f"{integration_step_s:g} s"
        )
    parameters = _parameters(car)
    model = multi_body()
    steps = round(manoeuvre.duration_s / integration_step_s)
    state = np.array(model.begin(manoeuvre.speed_m_s.at(0.0), parameters))
    rows = []
    for k in range(steps + 1):
        time_s = k * integration_step_s
        command = _command(manoeuvre, model, state, time_s, integration_step_s)
        try:
            slope = np.array(model.derivative(state.tolist(), command, parameters))
            if k % every == 0:
                sample = model.sample(state, slope, parameters)
                rows.append([state[_STEERING], state[_HEADING], *sample])
            state = _runge_kutta(model, state, slope, command, parameters, integration_step_s)
        except (ZeroDivisionError, OverflowError, ValueError):
            state = np.full(len(state), math.nan)
        if not np.isfinite(state).all():
            raise SpunOut(
                f"manoeuvre {manoeuvre.name!r} with {car.name}: the car spins out at {time_s:.2f} s"
                "; drive more slowly, or choose another car"
            )
    return _drive(np.array(rows), time_step_s)


def multi_body() -> Body:
    """The 29-state model with suspension, load transfer, wheels and combined-slip tyres."""
    _require_library()
    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

    def sample(x: np.ndarray, f: np.ndarray, p: Any) -> list[float]:
        # The library's left side has negative y, so it is the right side in our axes.
        wheels = [p.R_w * x[wheel] for wheel in (24, 23, 26, 25)]
        return [x[5], x[3], x[10], f[3], f[10], *wheels]

    return Body(
        lambda speed, p: init_mb([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0], p),
        vehicle_dynamics_mb,
        lambda x: CarMotion(x[0], x[1], x[4], x[3], x[10]),
        sample,
    )


def data_sheet(car: TrueCar) -> Car:
    """Return a car by the library's parameters; stiffness is the slope of its tyres at no slip.

    Raises:
        ValueError: the library is not installed.
    """
    p = _parameters(car)
    load_n = p.m * GRAVITY_M_S2 / (p.a + p.b)
    return Car(
        name=car.name,
        mass_kg=p.m,
        yaw_inertia_kg_m2=p.I_z,
        front_axle_m=p.a,
        rear_axle_m=p.b,
        front_stiffness_n_rad=-p.tire.p_ky1 * load_n * p.b,
        rear_stiffness_n_rad=-p.tire.p_ky1 * load_n * p.a,
        friction=p.tire.p_dy1,
        front_track_m=p.T_f,
        rear_track_m=p.T_r,
        driven_axle="front" if p.T_se > 0.5 else "rear",
    )


def _require_library() -> None:
    if importlib.util.find_spec("vehiclemodels") is None:
        raise ValueError(
            "simulated cars need the CommonRoad vehicle models, which are not installed: run "
            "`make extras`, or `pip install '.[vehicle]'` in a checkout of concord, or use a "
            "logged drive"
        )


def _parameters(car: TrueCar) -> Any:
    _require_library()
    from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

    parameters: Any = setup_vehicle_parameters(car.vehicle_id)
    tyre = replace(parameters.tire, **car.tyre_changes)
    return replace(parameters, tire=tyre)


def _command(
    manoeuvre: Manoeuvre, model: Body, state: np.ndarray, time_s: float, step_s: float
) -> list[float]:
    """Steering rate and acceleration that the driver wants."""
    motion = model.motion(state)
    wanted = manoeuvre.driver.steering(time_s, motion)
    rate = (wanted - state[_STEERING]) / max(manoeuvre.driver.lag_s, step_s)
    return [rate, SPEED_GAIN_1_S * (manoeuvre.speed_m_s.at(time_s) - motion.speed_m_s)]


def _runge_kutta(
    model: Body,
    state: np.ndarray,
    slope: np.ndarray,
    command: list[float],
    parameters: Any,
    h: float,
) -> np.ndarray:
    """Return the state h later; `slope` is the derivative at its beginning."""

    def derivative(at: np.ndarray) -> np.ndarray:
        return np.array(model.derivative(at.tolist(), command, parameters))

    second = derivative(state + 0.5 * h * slope)
    third = derivative(state + 0.5 * h * second)
    fourth = derivative(state + h * third)
    return state + h / 6 * (slope + 2 * second + 2 * third + fourth)


def _drive(rows: np.ndarray, time_step_s: float) -> Drive:
    steering, heading, yaw_rate, vx, vy, vx_rate, vy_rate = rows[:, :7].T
    return Drive(
        time_step_s=time_step_s,
        steering_rad=steering,
        yaw_rate_rad_s=yaw_rate,
        side_slip_rad=np.arctan(vy / vx),
        speed_m_s=vx,
        longitudinal_acceleration_m_s2=vx_rate - yaw_rate * vy,
        lateral_acceleration_m_s2=vy_rate + yaw_rate * vx,
        wheel_speed_m_s=rows[:, 7:],
        heading_rad=heading,
    )
