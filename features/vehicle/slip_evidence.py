"""How far the side slip of a logged car errs beyond its claim, which no innovation tells.

Errors of the tyres last longer than a step, so the filter takes them for side slip and innovations
stay small. A logged side slip shows them. So does the one to which yaw rate and lateral
acceleration add up (`slip_reference`), where the drive tells it.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from concord.features.vehicle.identification.slip_reference import SlipReference, slip_reference
from concord.features.vehicle.identification.sought import SEEN
from concord.features.vehicle.identification.without_slip import is_logged
from concord.features.vehicle.options import VehicleNetwork
from concord.features.vehicle.plant.corrections import corrected, steps_over, with_true_wheels
from concord.features.vehicle.plant.drive_log import even_drive, read_log, speeds_in
from concord.features.vehicle.plant.model import tanh_tyre
from concord.features.vehicle.plant.network import SIDE_SLIP
from concord.features.vehicle.plant.parameters import Car
from concord.features.vehicle.plant.tyre_identification import MODEL_STEP_S, identify
from concord.features.vehicle.plant.validity import SLOWEST_M_S
from concord.filters.gaussian import Gaussian
from concord.plants.recorded.channels import ChannelReadings, readings_between
from concord.results.figures.intervals import BATCHES, Interval, batch_means
from concord.results.verdict.findings import beyond
from concord.scenarios.catalogue import definition_of, scored_nees
from concord.scenarios.setup import Setup

_ERRS = {"overconfident": "by more than", "underconfident": "by less than", "": "as"}


class SlipEvidence(NamedTuple):
    """ANEES of the side slip of the filter that hears everything, beside the logged side slip, or
    beside a reference; NaN where the drive does not tell it.

    A reference stands for the truth, and its errors widen the interval. Its lower end is that of a
    filter that shares none of them; the upper end that of one that knows no more than the
    reference, whose errors add. `worst` is the largest ANEES of a tenth of the run, with its start
    and end in s.
    """

    anees: Interval
    logged: bool
    worst: tuple[float, float, float] = (np.nan, np.nan, np.nan)

    def in_words(self) -> str:
        """ "the side slip errs by more than ... claims (ANEES 2.9 where 1 is right, by ...)" """
        if np.isnan(self.anees.low):
            return "this drive does not tell how far the side slip errs"
        by, shown = "the logged one", f"{self.anees.value:.3g}"
        if not self.logged:
            by = "what yaw rate and lateral acceleration add up to, which errs too"
            shown = f"{self.anees.low:.2g} to {self.anees.high:.2g}"
        beyond_claim, (most, start_s, end_s) = beyond(self.anees), self.worst
        where = f"; most from {start_s:.3g} to {end_s:.3g} s of the run: {most:.3g}"
        return (
            f"the side slip errs {_ERRS[beyond_claim]} the filter that hears everything claims "
            f"(ANEES {shown} where 1 is right, by {by}"
            f"{where if beyond_claim == 'overconfident' and np.isfinite(most) else ''})"
        )


def slip_evidence(
    setup: Setup, belief: Gaussian, counted: np.ndarray, longest_s: float, confidence: float
) -> SlipEvidence:
    """Judge the beliefs (S, n) of the filter that hears everything, in the steps (S,) that count.

    A reference is sought in the first `longest_s` from the first step that counts.
    """
    plant = setup.scenario.plant
    assert isinstance(plant, VehicleNetwork) and plant.data is not None, "a drive was logged"
    channels, car = read_log(plant.data)
    logged = is_logged(channels, "side_slip")
    if logged:
        drive: Any = definition_of(setup.scenario).plant(setup.scenario)
        error = belief.mean - drive.truth[: len(counted)]
        every = scored_nees(setup.scenario, error, belief.cov)[None]
    else:
        grid = steps_over(corrected(channels, car.sensors), setup.time_step_s)
        times_s = grid.instants_s[: len(counted)]
        start_s = times_s[np.argmax(counted)]
        reference = reference_of(readings_between(channels, start_s, start_s + longest_s), car)
        if reference is None or reference.told > SEEN:
            return SlipEvidence(Interval(np.nan, np.nan, np.nan), logged)
        every = squares_beside(belief, reference, times_s)
    every = np.where(counted, every, np.nan)
    found = [batch_means(squares, confidence) for squares in every]
    anees = Interval(found[0].value, min(one.low for one in found), max(one.high for one in found))
    return SlipEvidence(anees, logged, _worst(every[0], setup.time_step_s))


def _worst(squares: np.ndarray, time_step_s: float) -> tuple[float, float, float]:
    """The batch of `batch_means` that errs most: its mean, and its ends in s."""
    known = np.flatnonzero(np.isfinite(squares))
    if len(known) < BATCHES:
        return np.nan, np.nan, np.nan
    batches = np.array_split(known, BATCHES)
    worst = max(batches, key=lambda batch: squares[batch].mean())
    return float(squares[worst].mean()), time_step_s * worst[0], time_step_s * worst[-1]


def reference_of(channels: Mapping[str, ChannelReadings], car: Car) -> SlipReference | None:
    """The side slip that a log tells without a slip sensor; None where nothing tells it."""
    if not {"yaw_rate", "steering"} <= channels.keys() or not speeds_in(channels):
        return None
    drive = even_drive(with_true_wheels(channels, car.sensors), MODEL_STEP_S)
    try:
        tyres = identify(drive, car, tanh_tyre, min_speed_m_s=SLOWEST_M_S)
    except ValueError:  # the drive tells nothing of the tyres
        return None
    return slip_reference(channels, tyres, tanh_tyre)


def squares_beside(belief: Gaussian, reference: SlipReference, times_s: np.ndarray) -> np.ndarray:
    """Squared differences (3, S) over the variances that estimates claim, NaN outside the
    reference: as they are, with those of the reference claimed too, and added as errors.

    The second are 1 on average where the errors of both are independent; the third where the
    reference is the mean of the truth, given all that estimates have heard.
    """
    stamps_s, values = reference.readings
    within = (times_s >= stamps_s[0]) & (times_s <= stamps_s[-1])
    square = np.square(belief.mean[:, SIDE_SLIP] - np.interp(times_s, stamps_s, values))
    errs = np.square(np.interp(times_s, stamps_s, reference.std_rad))
    claimed = belief.cov[:, SIDE_SLIP, SIDE_SLIP]
    found = np.stack([square / claimed, square / (claimed + errs), (square + errs) / claimed])
    return np.where(within, found, np.nan)
