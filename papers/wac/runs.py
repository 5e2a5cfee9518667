"""Runs of a plant as a network of the array program sees them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from filters.gaussian import Gaussian
from papers.kit.plant_runs import plant_runs
from scenarios.catalogue import kind_of
from scenarios.scenario import Scenario


class Runs(NamedTuple):
    """Truth and readings of R runs, and what the filters believe of the plant.

    truth: (steps, R, n); readings: (steps, R, N, d), NaN where a sensor took none; controls:
    (steps, R, p), each acting until the next step, or None; prior: mean (R, n), cov (n, n). `model`
    and `sensors` (of all nodes) are the plant's.
    """

    truth: np.ndarray
    readings: np.ndarray
    controls: np.ndarray | None
    prior: Gaussian
    model: Any
    sensors: Any


def simulate(scenario: Scenario, numbers: Sequence[int]) -> Runs:
    """The runs of those numbers."""
    kind = kind_of(scenario.name)
    plant: Any = kind.plant(scenario)
    driven = plant_runs(scenario, numbers)
    return Runs(
        driven.truth,
        driven.readings,
        driven.controls,
        Gaussian(driven.prior_mean, driven.prior_cov),
        kind.model(scenario),
        plant.sensors,
    )
