"""Parameters of a car with the greatest likelihood of a drive, and what the drive does not tell.

Output error gives the start (`output_error.py`). It also gives all but noise where the likeliest
values contradict it.

Method: Fisher scoring with a prior (`scoring.py`). A parameter
that is not a noise stays at its value in the file if the drive leaves more than half of its prior
deviation; then the others are fitted again. Intervals are of 95 %. They have the robust covariance
M^-1 J M^-1, of the information M and the scatter J of the scores (White 1982, Maximum likelihood
estimation of misspecified models). So they also hold for errors of the model that look like noise,
around the parameters that fit best. For what the model leaves out, the process noise stands in.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from concord.features.vehicle.identification.likelihood import Likelihood, likelihood, widths_of
from concord.features.vehicle.identification.logged_readings import LoggedReadings, logged_readings
from concord.features.vehicle.identification.output_error import OutputError, by_output_error
from concord.features.vehicle.identification.scoring import (
    ITERATIONS,
    Best,
    at_samples,
    greatest,
    precision,
)
from concord.features.vehicle.identification.slip_claim import SlipClaim, covering, slip_claim
from concord.features.vehicle.identification.slip_reference import SlipReference
from concord.features.vehicle.identification.sought import (
    SEEN,
    Sought,
    car_with,
    sought_of,
    told,
    value_at,
)
from concord.features.vehicle.identification.without_slip import SMALL, Heard, as_heard
from concord.features.vehicle.plant.model import Tyre
from concord.features.vehicle.plant.parameters import Car
from concord.plants.recorded.channels import ChannelReadings

NORMAL_95 = 1.959964
MOST_STEPS = 3 * ITERATIONS
"""Of all parameters, of those that are seen, and of noise alone."""


class FoundParameter(NamedTuple):
    """One parameter after the fit.

    Attributes:
        sought: which one.
        before, value: in the file, and with the greatest likelihood.
        low, high: interval of 95 %; of a noise that the drive does not tell, 0 and its bound.
        seen: whether the drive tells it; otherwise it stays as it was, unless it is a noise.
    """

    sought: Sought
    before: float
    value: float
    low: float
    high: float
    seen: bool


class CarFit(NamedTuple):
    """A fitted car, its parameters, and NIS per degree of freedom before and after.

    `freedoms` is the number of innovations; `converged` is False where steps ran out. The fit heard
    a reference of the side slip with the standard deviation `reference_rad`, None for no reference.
    `claim` is None where the fit heard no side slip. It may raise noise in the car. `far` are the
    parameters for which innovations and outputs disagree: then all but noise is of the outputs.
    """

    car: Car
    found: tuple[FoundParameter, ...]
    nis_before: float
    nis_after: float
    freedoms: int
    converged: bool
    reference_rad: float | None
    claim: SlipClaim | None
    far: tuple[Sought, ...]


_UNTOLD = (0.0, np.inf, np.inf)
"""Spread and deviations of a parameter that the log does not tell."""


def fit(
    channels: Mapping[str, ChannelReadings],
    car: Car,
    tyre: Tyre,
    *,
    friction: bool,
    ratio: bool,
    time_step_s: float,
    min_speed_m_s: float,
    reference: SlipReference | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> CarFit:
    """Fit a car to a log, from the values of its file.

    Args:
        channels: readings by the fields of `drive_log.ColumnMap`, each with its own stamp.
        car: the file's values are the means of the priors.
        tyre: law of the lateral force.
        friction, ratio: whether the friction, and the ratio of the steering wheel, are sought.
        time_step_s: of the filter.
        min_speed_m_s: slower parts do not count.
        reference: the side slip of a log that has none; the fit hears it if the drive tells it.
        on_step: is called before each step.
    """
    every = sought_of(channels, car, friction=friction, ratio=ratio)
    heard = as_heard(Heard(channels, car, every), reference)
    tried = heard.sought
    fitted = _fitted(heard, tyre, time_step_s, min_speed_m_s, on_step)
    log, spreads, deviations = fitted.log, fitted.spreads, fitted.deviations
    from_file = spreads + np.where(np.isinf(deviations[0]), 0.0, _read_apart(tried, log.car, car))
    told_of = {
        one.path: tuple(three) for one, *three in zip(tried, from_file, *deviations, strict=True)
    }
    found = tuple(
        _found(one, value_at(car, one.path), *told_of.get(one.path, _UNTOLD)) for one in every
    )
    moved = np.array([told_of.get(one.path, _UNTOLD)[0] for one in every])
    after, claim = car_with(car, every, moved), None
    if "side_slip" in log.sensors:
        # Without a slip sensor no reading tells how the tyres err in other drives.
        blind = heard.reference_rad is not None
        least_rad = car.process_noise.side_slip_rad if blind else 0.0
        read = car_with(log.car, tried, spreads)
        claim = slip_claim(log, read, tyre, least_rad, by_reference=blind)
        after = covering(after, least_rad, claim.factor)
    return CarFit(
        _in_new_ratio(after, car),
        found,
        fitted.first.nis,
        fitted.best.likelihood.nis,
        fitted.first.freedoms,
        fitted.best.converged,
        heard.reference_rad,
        claim,
        tuple(tried[place] for place in fitted.far),
    )


def _read_apart(tried: tuple[Sought, ...], read: Car, file: Car) -> np.ndarray:
    """Spreads (p,) by which delays with which sensors were read differ from those of the file."""
    apart = [value_at(read, one.path) - value_at(file, one.path) for one in tried]
    return np.array(
        [by / one.spread if one.is_delay else 0.0 for by, one in zip(apart, tried, strict=True)]
    )


class _Fitted(NamedTuple):
    """The readings, their likelihood with the file and at the end, and what that is at.

    `spreads` (p,) have deviations (p,) under the model and robust ones. `far` are the places of
    parameters which the innovations would have elsewhere than the outputs; without any, all is of
    the innovations.
    """

    log: LoggedReadings
    first: Likelihood
    best: Best
    spreads: np.ndarray
    deviations: tuple[np.ndarray, np.ndarray]
    far: tuple[int, ...] = ()


def _fitted(
    heard: Heard,
    tyre: Tyre,
    time_step_s: float,
    min_speed_m_s: float,
    on_step: Callable[[], None],
) -> _Fitted:
    """Fit the parameters sought to the readings heard; arguments as in `fit`."""
    tried = heard.sought

    def read(channels: Mapping[str, ChannelReadings]) -> LoggedReadings:
        return logged_readings(channels, heard.car, time_step_s, min_speed_m_s)

    log = read(heard.channels)
    widths = widths_of(log, tyre, tried, np.zeros(len(tried)))

    def of(kept: np.ndarray, log: LoggedReadings = log) -> Callable[[np.ndarray], Likelihood]:
        some = tuple(one for one, keep in zip(tried, kept, strict=True) if keep)

        def of_some(spreads: np.ndarray) -> Likelihood:
            on_step()
            return likelihood(log, tyre, some, spreads, widths[kept])

        return of_some

    samples = np.array([time_step_s / one.spread if one.is_delay else 0.0 for one in tried])
    kept = np.ones(len(tried), dtype=bool)
    first, driven = of(kept)(np.zeros(len(tried))), by_output_error(log, tyre, tried)
    best = greatest(of(kept), driven.spreads, samples)
    seen = told(tried, precision(best.likelihood))
    # Far from the truth a delay that shows much has little curvature.
    before = widths
    widths = widths_of(log, tyre, tried, at_samples(best.spreads, samples))
    if not seen.all() or (widths != before).any():
        kept = seen
        best = greatest(of(kept), best.spreads[kept], samples[kept])
    spreads = np.zeros(len(tried))
    spreads[kept] = best.spreads
    last = at_samples(best.spreads, samples[kept])
    gradients = [of(kept, read(one))(last).gradient for one in heard.with_errors()]
    moves = [(one - gradients[0]) / SMALL for one in gradients]
    deviations = _deviations(best.likelihood, kept, moves)
    fitted = _Fitted(log, first, best, spreads, deviations)
    far = np.flatnonzero(driven.is_far(spreads, deviations[0]))
    if heard.reference_rad is not None or not len(far):
        return fitted
    return _with_noise(fitted._replace(far=tuple(far.tolist())), driven, tyre, tried, on_step)


def _with_noise(
    fitted: _Fitted,
    driven: OutputError,
    tyre: Tyre,
    tried: tuple[Sought, ...],
    on_step: Callable[[], None],
) -> _Fitted:
    """The parameters by output error, and noise fitted to the innovations that they leave."""
    noise = np.array([one.is_noise for one in tried])
    some = tuple(one for one in tried if one.is_noise)
    car = car_with(fitted.log.car, tried, driven.spreads)

    def of_noise(spreads: np.ndarray) -> Likelihood:
        on_step()
        return likelihood(fitted.log, tyre, some, spreads, np.ones(len(some)), car)

    best = greatest(of_noise, np.zeros(len(some)), np.zeros(len(some)))
    spreads = driven.spreads.copy()
    spreads[noise] = best.spreads
    std, robust = (
        np.where(noise, of_noise, driven.std)
        for of_noise in _deviations(best.likelihood, noise, ())
    )
    return fitted._replace(best=best, spreads=spreads, deviations=(std, robust))


def _deviations(
    here: Likelihood, kept: np.ndarray, moves: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (p,) of the parameters under the model, and robust ones; infinite if not kept.

    A robust one is at most that of the prior, which is 1.
    `moves` are changes of the gradient by independent errors of a reference (Murphy and Topel 1985,
    Estimation and inference in two-step econometric models).
    """
    std, robust = np.full((2, len(kept)), np.inf)
    cov = np.linalg.inv(precision(here))
    std[kept] = np.sqrt(np.diagonal(cov))
    scatter = here.scatter + np.eye(len(cov)) + sum(np.outer(move, move) for move in moves)
    robust[kept] = np.minimum(np.sqrt(np.diagonal(cov @ scatter @ cov)), 1.0)
    return std, robust


def _found(one: Sought, before: float, spreads: float, std: float, robust: float) -> FoundParameter:
    if np.isinf(std):
        return FoundParameter(one, before, before, np.nan, np.nan, False)
    low, value, high = (
        float(one.value(before, spreads + by * robust)) for by in (-NORMAL_95, 0.0, NORMAL_95)
    )
    if std > SEEN:
        return FoundParameter(one, before, value, 0.0, high, False)
    return FoundParameter(one, before, value, low, high, True)


def _in_new_ratio(car: Car, before: Car) -> Car:
    """The car with errors of the steering in the angle that its own ratio gives."""
    gain, sheet = car.steering_ratio / before.steering_ratio, car.sensors.steering
    steering = replace(sheet, noise=sheet.noise / gain, offset=sheet.offset / gain)
    return replace(car, sensors=replace(car.sensors, steering=steering))
