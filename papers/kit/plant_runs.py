"""Many runs of a scenario's plant as arrays over (steps, runs): a small loop over the runs."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.streams import generator


class PlantRuns(NamedTuple):
    """Truth and readings of R runs.

    truth: (steps, R, n); readings: (steps, R, N, d), NaN where a sensor took none; controls:
    (steps, R, p), each acting until the next step, or None; prior_mean: (R, n); prior_cov: (n, n).
    """

    truth: np.ndarray
    readings: np.ndarray
    controls: np.ndarray | None
    prior_mean: np.ndarray
    prior_cov: np.ndarray


def plant_runs(scenario: Scenario, numbers: Sequence[int]) -> PlantRuns:
    """Drive the plant through the runs of these numbers, with the noise that every driver gives.

    The loop is closed through the truth, or open.
    """
    definition = definition_of(scenario)
    plant: Any = definition.plant(scenario)
    draws = [
        plant.draw(partial(generator, replace(scenario, run=run)), scenario.steps)
        for run in numbers
    ]
    process = np.stack([one.process for one in draws], axis=1)
    sensing = np.stack([one.measurement for one in draws], axis=1)
    state, prior_mean, prior_cov = plant.initial(np.stack([one.initial for one in draws]))
    law = definition.controller(scenario)
    memory = np.zeros(0) if law is None else law.initial_memory
    truth, readings, controls = [], [], []
    for step in range(scenario.steps):
        truth.append(state)
        readings.append(plant.observe(state, sensing[step], step)[..., 0, :])
        control = None
        if law is not None:
            control, memory = law.control(state, memory, step)
            controls.append(control)
        state = plant.advance(state, control, process[step], step)
    return PlantRuns(
        np.array(truth),
        np.array(readings),
        np.array(controls) if law is not None else None,
        prior_mean,
        prior_cov,
    )
