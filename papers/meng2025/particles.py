"""The yardstick of `reproduce meng2025`: a bootstrap particle filter behind the same bus."""

import numpy as np

from concord.bus.schedule import Schedule
from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.meng2025 import DEFINITION, SYSTEM
from concord.filters.particle import Particles, cov, mean, resample
from concord.papers.meng2025.runs import MeasuredBatch, SlotEstimates, transmit
from concord.scenarios.setup import generator

PARTICLES = 2000
# So many runs at a time: their particles fit into the cache.
_TOGETHER = 25


def track(batch: MeasuredBatch, schedule: Schedule, particles: int = PARTICLES) -> SlotEstimates:
    """Posterior means and covariances by particles, with a stream of their own for every run.

    The schedule lets one scalar sensor send per slot. The likelihood is exact: given the state, a
    measurement is Gaussian with variance R + Pi x' Gamma x.
    """
    slots = transmit(batch, schedule)
    parts = [
        _track(batch.seed, runs, slots.received[:, runs], slots.fresh[:, runs], particles)
        for runs in np.array_split(np.arange(batch.runs), -(-batch.runs // _TOGETHER))
    ]
    means, covs = (np.concatenate(both, axis=1) for both in zip(*parts, strict=True))
    return SlotEstimates(means, covs, slots.sent)


def _track(
    seed: int, runs: np.ndarray, received: np.ndarray, fresh: np.ndarray, particles: int
) -> tuple[np.ndarray, np.ndarray]:
    """Means (S + 1, R, n) and covariances of some runs."""
    n, numbers = meng2025.STATES, meng2025.STATES + SYSTEM.process(0).numbers
    streams = [
        generator(DEFINITION.defaults.with_(seed=seed, run=int(run)), "particles", 0)
        for run in runs
    ]
    start = np.stack([stream.standard_normal((particles, n)) for stream in streams])
    states = meng2025.PRIOR_MEAN + start @ np.linalg.cholesky(meng2025.PRIOR_COV).T
    cloud = Particles(states, np.zeros(states.shape[:-1]))
    means, covs = [mean(cloud)], [cov(cloud)]
    for step, (values, sent) in enumerate(zip(received, fresh, strict=True), start=1):
        cloud = resample(cloud, np.array([stream.random() for stream in streams]))
        noise = np.stack([stream.standard_normal((particles, numbers)) for stream in streams])
        states = SYSTEM.advance(cloud.states, None, noise, step - 1)
        logs = cloud.log_weights + log_likelihood(states, values, sent, step)
        cloud = Particles(states, logs)
        means.append(mean(cloud))
        covs.append(cov(cloud))
    return np.stack(means), np.stack(covs)


def log_likelihood(
    states: np.ndarray, values: np.ndarray, sent: np.ndarray, step: int
) -> np.ndarray:
    """Of states (R, P, n), up to a constant, given values (R, m) of which `sent` (R, m) came."""
    assert (sent.sum(axis=-1) == 1).all(), "entries that come together are correlated"
    chosen = sent.argmax(axis=-1)[:, None]
    seen = np.take_along_axis(SYSTEM.measure(states, step), chosen[..., None], axis=-1)[..., 0]
    moment = SYSTEM.measurement_moment(step)
    sizes = np.einsum("...i,tij,...j->...t", states, moment.gamma, states)
    variances = np.diagonal(moment.pi, axis1=-2, axis2=-1)[:, chosen[:, 0]]
    noise = SYSTEM.measurement_noise_cov(step).diagonal()[chosen]
    spread = noise + np.einsum("rpt,tr->rp", sizes, variances)
    innovation = np.take_along_axis(values, chosen, axis=-1) - seen
    return -0.5 * (innovation**2 / spread + np.log(spread))
