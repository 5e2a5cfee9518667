"""Whether the filters know how wrong they are, on data that obey their model exactly."""

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.model import SingleTrack
from concord.filters.metrics import nees
from concord.papers.adlukf.filters import Contestant
from concord.papers.adlukf.study import CHANNELS, PRIOR_COV, ManoeuvreStudy, NoiseCase, estimate


def matched_study(drive: Drive, model: SingleTrack, seeds: int, seed: int) -> ManoeuvreStudy:
    """Cars that move as the model says, with its process noise, under the steering of a drive."""
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    start = np.broadcast_to(drive.states[0], (seeds, 3))
    factor = np.linalg.cholesky(model.process_noise_cov(0))
    truth = [start]
    for k in range(drive.steps - 1):
        moved = model.transition(truth[-1], drive.inputs[k], k)
        truth.append(moved + generator.standard_normal((seeds, 3)) @ factor.T)
    states = np.array(truth)
    std = np.array([error.std for error in CHANNELS.values()])
    exact = np.stack(
        [model.measure(state, control) for state, control in zip(states, drive.inputs, strict=True)]
    )
    readings = exact + std * generator.standard_normal(exact.shape)
    error = generator.standard_normal((seeds, 3)) @ np.linalg.cholesky(PRIOR_COV).T
    lane = (slice(None), None, None)
    return ManoeuvreStudy(
        model=model,
        cases=(NoiseCase("matched", "the model is exact"),),
        controls=drive.inputs[:, None, None, None],
        measurements=readings[lane],
        believed=np.broadcast_to(std**2, (1, 1, seeds, 3)),
        start=(start + error)[None, None],
        truth=states[lane],
    )


def average_nees(study: ManoeuvreStudy, contestant: Contestant) -> np.ndarray:
    """Mean of e' P^-1 e over all steps but the first, per seed (seeds,); 3 is consistent."""
    belief = estimate(study, contestant)
    return nees(belief.mean - study.truth, belief.cov)[1:].mean(axis=0)[0, 0]
