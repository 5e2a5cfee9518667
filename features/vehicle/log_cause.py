"""The value of a car's file that alone explains most of what a log leaves unexplained, in words."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from msgspec import structs

from concord.features.vehicle.identification.logged_readings import logged_readings
from concord.features.vehicle.identification.sought import sought_of
from concord.features.vehicle.identification.suspects import Suspect, suspect
from concord.features.vehicle.identification.without_slip import (
    HIDDEN,
    STEADY,
    left_to_file,
    tells_slip,
)
from concord.features.vehicle.options import VehicleNetwork
from concord.features.vehicle.plant.drive_log import logs_road_wheels, read_log
from concord.features.vehicle.plant.model import tanh_tyre
from concord.features.vehicle.plant.parameters import Car, ProcessNoise
from concord.features.vehicle.plant.validity import SLOWEST_M_S
from concord.features.vehicle.slip_evidence import reference_of, slip_evidence
from concord.filters.gaussian import Gaussian
from concord.plants.recorded.channels import ChannelReadings, readings_between
from concord.scenarios.scenario_definition import Explanation
from concord.scenarios.setup import Setup

LONGEST_S = 30.0
"""Time of a log that is searched, from its first scored step on; a second takes half a second."""
_CONFIDENCE = 0.995
_DRIVER: dict[tuple[str, ...], str] = {
    ("process_noise", "steering_rad"): "steers",
    ("process_noise", "acceleration_m_s2"): "accelerates",
}
"""Values that belong to a driver and a road: other drives of the car have others."""


def explained(setup: Setup, belief: Gaussian, counted: np.ndarray, cure: str) -> Explanation:
    """Tell the causes that a logged drive shows, from the steps (S,) that count, some of which do.

    `belief` (S, n) is that of the filter that hears everything.
    """
    slip = slip_evidence(setup, belief, counted, LONGEST_S, _CONFIDENCE)
    cause = log_cause(setup, counted)
    misread = "look at units, signs and stamps in columns.toml before car.toml"
    return Explanation(cure, cause, misread if cause else "", slip.in_words(), slip.anees)


def log_cause(setup: Setup, counted: np.ndarray) -> str:
    """The sentence on the cause, from the steps (S,) that count.

    Empty where no value of the car's file is wrong beyond chance. A log without side slip does not
    tell values of the tyres from those that cover their errors.
    """
    plant = setup.scenario.plant
    assert isinstance(plant, VehicleNetwork) and plant.data is not None, "a drive was logged"
    channels, car = read_log(plant.data)
    car = structs.replace(car, process_noise=_times(car, plant.process_noise))
    log = logged_readings(channels, car, setup.time_step_s, SLOWEST_M_S)
    end = min(len(counted), int(np.argmax(counted)) + round(LONGEST_S / setup.time_step_s))
    log = replace(log, readings=log.readings[:end], counted=log.counted[:end] & counted[:end])
    ratio = not logs_road_wheels(plant.data)
    every = sought_of(channels, car, friction=False, ratio=ratio)
    found = suspect(log, car, tanh_tyre, every)
    if found is None:
        return ""
    start_s = min(one.stamps_s[0] for one in channels.values() if len(one.values))
    start_s += setup.time_step_s * int(np.argmax(counted))
    untold = _untold(
        found.sought.path, readings_between(channels, start_s, start_s + LONGEST_S), car
    )
    if untold:
        return (
            f"of single values of car.toml, {found.sought.name} explains most, but {untold} does "
            "not tell it from errors of the tyres: log the side slip, or drive a serpentine; "
            f"{_identify(plant.data)} fits the rest"
        )
    return in_words(found, plant.data)


def _untold(path: tuple[str, ...], channels: Mapping[str, ChannelReadings], car: Car) -> str:
    """Which drive does not tell a value, so that `identify` leaves it; empty if it does."""
    if path in HIDDEN and not tells_slip(channels, None):
        return "a log without side slip"
    if path in STEADY and path in left_to_file(channels, reference_of(channels, car)):
        return "a drive that changes its side slip so slowly"
    return ""


def _times(car: Car, factor: float) -> ProcessNoise:
    noise = car.process_noise
    return structs.replace(noise, **{n: factor * v for n, v in structs.asdict(noise).items()})


def in_words(found: Suspect, data: str) -> str:
    """ "of single values of car.toml, the offset of yaw rate explains most: ..." """
    interval = f" (95 %: {found.low:.3g} to {found.high:.3g})" if np.isfinite(found.low) else ""
    value = f"{found.value:.3g}{interval} {found.sought.unit}".rstrip()
    instead = f"{found.sought.name} explains most: {value} in place of {found.before:.3g}"
    acts, more = _DRIVER.get(found.sought.path), found.value > found.before
    if acts:
        said = f"{instead}; the driver {acts} {'more' if more else 'less'} sharply than that"
        return f"of single values of car.toml, {said}, which is no fault of the car"
    return f"of single values of car.toml, {instead}; {_identify(data)} fits all"


def _identify(data: str) -> str:
    return f"`concord identify-car --data {data}`"
