"""Measure one step of each filter: evaluations of the models, and time on this machine."""

import time
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model
from concord.papers.adlukf.filters import CONTESTANTS, Contestant, StepInput
from concord.papers.adlukf.study import PRIOR_COV, ManoeuvreStudy

STEPS = 300


class FilterCost(NamedTuple):
    """Sigma points that went through a model in a step, and seconds per step."""

    evaluations: float
    seconds: float


def costs(study: ManoeuvreStudy) -> dict[str, FilterCost]:
    """The cost of every filter on one lane of a study.

    The time is the least of three runs, and belongs to this machine.
    """
    return {name: _cost(study, contestant) for name, contestant in CONTESTANTS.items()}


def _cost(study: ManoeuvreStudy, contestant: Contestant) -> FilterCost:
    points = 0

    def counted(model: Model, states: np.ndarray) -> np.ndarray:
        nonlocal points
        points += states.size // states.shape[-1]
        return model(states)

    def run(wrap: bool) -> float:
        belief = Gaussian(study.start[0, 0, 0], PRIOR_COV)
        Q = study.model.process_noise_cov(0)
        memory = contestant.begin(Q, study.believed[0, 0, 0])
        started = time.perf_counter()
        for k in range(1, STEPS + 1):
            f = partial(study.model.transition, control=study.controls[k - 1, 0, 0, 0], step=k - 1)
            h = partial(study.model.measure, control=study.controls[k, 0, 0, 0])
            if wrap:
                f, h = partial(counted, f), partial(counted, h)
            task = StepInput(f, h, study.measurements[k, 0, 0, 0], Q)
            belief, memory = contestant.step(belief, memory, task)
        assert np.isfinite(belief.mean).all(), f"{contestant.name} failed while it was timed"
        return (time.perf_counter() - started) / STEPS

    run(wrap=True)
    return FilterCost(points / STEPS, min(run(wrap=False) for _ in range(3)))
