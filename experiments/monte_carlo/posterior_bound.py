"""Posterior Cramer-Rao bound on the error of every filter that hears every node.

Source: Tichavsky, Muravchik, Nehorai (1998), "Posterior Cramer-Rao bounds for discrete-time
nonlinear filtering", IEEE Transactions on Signal Processing 46(5), equation 21. Equations 34 to 36
give the terms for additive Gaussian noise, with F and H the Jacobians at the truth:

    D11 = E[F' Q^-1 F],  D12 = -E[F'] Q^-1,  D22 = Q^-1
    J[k+1] = D22 - D12' (J[k] + D11)^-1 D12 + E[sum over the readings of H' R^-1 H]

The expectations are means over Monte-Carlo truths. The bound takes the set of readings as given. A
missing reading of a sensor with a limited field of view also carries information, but no filter
here uses it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.filters.linalg import inverse_spd, symmetrise
from concord.filters.update import without_rows
from concord.nodes.rules.local_filter import Model, Sensor, SensorGroup, StateNoise

# Steps of the differences, in prior standard deviations: the scale on which beliefs see a model.
STEP = 1e-4
# A process noise with a smaller ratio of eigenvalues than this moves some direction not at all.
SINGULAR = 1e-12


class Truths(NamedTuple):
    """Histories of R runs: truth (R, steps, n) and readings (R, steps, N, r, d), NaN without a
    reading.

    `control` (R, steps, p) acts into each step, or is None.
    """

    truth: np.ndarray
    readings: np.ndarray
    control: np.ndarray | None


def posterior_bound(
    truths: Truths, prior_cov: np.ndarray, model: Model, groups: Sequence[SensorGroup]
) -> np.ndarray:
    """Return the bound (steps, n, n) on the error covariance after each step's readings.

    All NaN where it is not defined: the truth is not known, noise depends on the state, or part of
    a nonlinear model has no noise at all.
    """
    steps, n = truths.truth.shape[1:]
    nothing = np.full((steps, n, n), np.nan)
    noises = (model, *(group.sensor for group in groups))
    if np.isnan(truths.truth).any() or any(isinstance(one, StateNoise) for one in noises):
        return nothing
    scale = STEP * np.sqrt(np.diag(prior_cov))
    bound = prior_cov
    bounds = nothing
    for step in range(steps):
        if step > 0:
            bound = _predicted(bound, truths, model, scale, step - 1)
        gained = _information(truths, groups, scale, step)
        bound = inverse_spd(symmetrise(inverse_spd(bound) + gained))
        bounds[step] = bound
    return bounds


def _predicted(
    bound: np.ndarray, truths: Truths, model: Model, scale: np.ndarray, step: int
) -> np.ndarray:
    """Return the bound carried from `step` to the next, without its readings."""
    noise_cov = model.process_noise_cov(step)
    control = None if truths.control is None else truths.control[:, step + 1]
    jacobians = _jacobian(
        partial(model.transition, control=control, step=step), truths.truth[:, step], scale
    )
    mean = jacobians.mean(axis=0)
    spread = np.abs(jacobians - mean).max()
    if spread <= 1e-7 * np.abs(mean).max():
        # A linear model: the same in covariances, which a singular noise does not stop.
        return symmetrise(mean @ bound @ mean.T + noise_cov)
    eigenvalues = np.linalg.eigvalsh(noise_cov)
    if eigenvalues[0] <= SINGULAR * eigenvalues[-1]:
        return np.full_like(bound, np.nan)
    precision = inverse_spd(noise_cov)
    crossed = precision @ mean
    both = inverse_spd(bound) + (jacobians.mT @ precision @ jacobians).mean(axis=0)
    return inverse_spd(symmetrise(precision - crossed @ inverse_spd(symmetrise(both)) @ crossed.T))


def _information(
    truths: Truths, groups: Sequence[SensorGroup], scale: np.ndarray, step: int
) -> np.ndarray:
    """E[sum over the readings of H' R^-1 H] (n, n) at a step."""
    runs, n = truths.truth.shape[0], truths.truth.shape[-1]
    total = np.zeros((n, n))
    taken = np.logical_not(np.isnan(truths.readings[:, step]).all(axis=-1))
    for group in groups:
        readings, read = group.of(truths.readings[:, step]), group.of(taken)
        which = np.flatnonzero(read.any(axis=(1, 2)))
        if not len(which):
            continue
        slopes = _slopes(group.sensor, truths.truth[which, step], read.shape[1], scale, step)
        for place in range(read.shape[2]):
            value, noise_cov = group.sensor.interpret(readings[which, :, place])
            noise_cov = np.broadcast_to(noise_cov, (*value.shape, value.shape[-1]))
            at = read[which, :, place]
            total += _of_readings(value[at], noise_cov[at], slopes[at])
    return symmetrise(total / runs)


def _of_readings(value: np.ndarray, noise_cov: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Sum of H' R^-1 H (n, n) over readings (K, m), of noise (K, m, m) and slopes (K, m, n)."""
    missing = np.isnan(value)
    if missing.any():
        noise_cov = without_rows(noise_cov, missing)
        slopes = np.where(missing[..., None], 0.0, slopes)
    weighed = np.einsum("kij,kja->kia", inverse_spd(noise_cov), slopes)
    n = slopes.shape[-1]
    return slopes.reshape(-1, n).T @ weighed.reshape(-1, n)


def _slopes(
    sensor: Sensor, states: np.ndarray, nodes: int, scale: np.ndarray, step: int
) -> np.ndarray:
    """Jacobians (R, N, m, n) of the sensor of N nodes at states (R, n)."""
    n = len(scale)
    shape = (n, len(states), nodes, n)
    ahead, behind = (
        sensor.measure(
            np.broadcast_to((states + sign * np.diag(scale)[:, None])[:, :, None], shape), step
        )
        for sign in (1, -1)
    )
    return np.moveaxis(sensor.residual(ahead, behind), 0, -1) / (2 * scale)


def _jacobian(
    transition: Callable[[np.ndarray], np.ndarray], states: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Jacobians (R, n, n) of a transition at states (R, n), by central differences."""
    moved = [transition(states + sign * np.diag(scale)[:, None]) for sign in (1, -1)]
    return np.moveaxis((moved[0] - moved[1]) / (2 * scale)[:, None, None], 0, -1)
