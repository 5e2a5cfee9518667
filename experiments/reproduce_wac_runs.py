"""Many runs of a plant: truth, readings and controls as arrays over (steps, runs)."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from filters.gaussian import Gaussian
from nodes.messages import Array
from scenarios.catalogue import kind_of
from scenarios.scenario import Scenario
from scenarios.setup import generator


class Runs(NamedTuple):
    """What happened, and what filters believe of it.

    truth: (steps, R, n); readings: (steps, R, N, d), NaN where none was taken; controls: (steps, R,
    p), each acting until the next step, or None; prior: mean (R, n), cov (n, n). `model` and
    `sensors` (of all nodes) are the plant's.
    """

    truth: Array
    readings: Array
    controls: Array | None
    prior: Gaussian
    model: Any
    sensors: Any


def simulate(scenario: Scenario, numbers: Sequence[int]) -> Runs:
    """The runs of those numbers: the noise of each is what every driver gives it.

    Its loop is closed through the truth, or open.
    """
    kind = kind_of(scenario.name)
    plant: Any = kind.plant(scenario)
    draws = [
        plant.draw(partial(generator, replace(scenario, run=run)), scenario.steps)
        for run in numbers
    ]
    process = np.stack([one.process for one in draws], axis=1)
    watching = np.stack([one.measurement for one in draws], axis=1)
    state, prior_mean, prior_cov = plant.initial(np.stack([one.initial for one in draws]))
    law = kind.controller(scenario)
    memory = np.zeros(0) if law is None else law.initial_memory
    truth, readings, controls = [], [], []
    for step in range(scenario.steps):
        truth.append(state)
        readings.append(plant.observe(state, watching[step], step)[..., 0, :])
        control = None
        if law is not None:
            control, memory = law.control(state, memory, step)
            controls.append(control)
        state = plant.advance(state, control, process[step], step)
    return Runs(
        np.array(truth),
        np.array(readings),
        np.array(controls) if law is not None else None,
        Gaussian(prior_mean, prior_cov),
        kind.model(scenario),
        plant.sensors,
    )
