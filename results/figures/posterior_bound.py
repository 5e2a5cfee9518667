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
    slopes = _derivatives(
        partial(model.transition, control=control, step=step),
        truths.truth[:, step],
        scale,
        np.subtract,
    )
    mean = slopes.mean(axis=1).T
    spread = np.abs(slopes - slopes.mean(axis=1, keepdims=True)).max()
    if spread <= 1e-7 * np.abs(mean).max():
        # A linear model: the same in covariances, which a singular noise does not stop.
        return symmetrise(mean @ bound @ mean.T + noise_cov)
    eigenvalues = np.linalg.eigvalsh(noise_cov)
    if eigenvalues[0] <= SINGULAR * eigenvalues[-1]:
        return np.full_like(bound, np.nan)
    precision = inverse_spd(noise_cov)
    crossed = precision @ mean
    both = inverse_spd(bound) + _gained(slopes, precision) / slopes.shape[1]
    return inverse_spd(symmetrise(precision - crossed @ inverse_spd(symmetrise(both)) @ crossed.T))


def _information(
    truths: Truths, groups: Sequence[SensorGroup], scale: np.ndarray, step: int
) -> np.ndarray:
    """E[sum over the readings of H' R^-1 H] (n, n) at a step."""
    runs, n = truths.truth.shape[0], truths.truth.shape[-1]
    total = np.zeros((n, n))
    for group in groups:
        readings = group.of(truths.readings[:, step])
        which = np.logical_not(np.isnan(readings).all(axis=(1, 2, 3)))
        if not which.any():
            continue
        states = truths.truth[:, step]
        if not which.all():
            readings, states = readings[which], states[which]
        measure = partial(_measured_by_all, group.sensor, readings.shape[1], step)
        slopes = _derivatives(measure, states, scale, group.sensor.residual)
        for place in range(readings.shape[2]):
            value, noise_cov = group.sensor.interpret(readings[:, :, place])
            total += _of_readings(value, noise_cov, slopes)
    return symmetrise(total / runs)


def _of_readings(value: np.ndarray, noise_cov: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Sum of H' R^-1 H (n, n) over readings (R, N, m), of noise (..., m, m) and slopes
    (n, R, N, m); what is NaN was not taken."""
    missing = np.isnan(value)
    if not missing.any():
        return _gained(slopes, inverse_spd(_one_of_all(noise_cov)))
    partly = (missing != missing[..., :1]).any()
    noise_cov = without_rows(noise_cov, missing) if partly else _one_of_all(noise_cov)
    return _gained(np.where(missing, 0.0, slopes), inverse_spd(noise_cov))


def _one_of_all(cov: np.ndarray) -> np.ndarray:
    """The covariance (m, m) of lanes (..., m, m) that share the memory of one, else those."""
    lanes = cov.ndim - 2
    return cov[(0,) * lanes] if lanes and not any(cov.strides[:lanes]) else cov


def _gained(slopes: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Sum of H' W H (n, n) over all lanes of slopes (n, ..., m), H' lane by lane, and of W (m, m)
    or (..., m, m)."""
    # The lanes stay where they are in memory, and one product sums over them. Precisions are
    # symmetric.
    if precision.ndim == 2:
        weighed = slopes.reshape(-1, len(precision)) @ precision
    else:
        weighed = np.einsum("...ij,a...j->a...i", precision, slopes)
    return slopes.reshape(len(slopes), -1) @ weighed.reshape(len(slopes), -1).T


def _measured_by_all(sensor: Sensor, nodes: int, step: int, states: np.ndarray) -> np.ndarray:
    """Return what the sensors (N) of a group measure (..., N, m) of states (..., n)."""
    shape = (*states.shape[:-1], nodes, states.shape[-1])
    return sensor.measure(np.broadcast_to(states[..., None, :], shape), step)


def _derivatives(
    function: Callable[[np.ndarray], np.ndarray],
    states: np.ndarray,
    scale: np.ndarray,
    residual: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Derivatives (n, R, ..., m) of a function at states (R, n) by each state, by central
    differences."""
    ahead, behind = (function(states + sign * np.diag(scale)[:, None]) for sign in (1, -1))
    difference = residual(ahead, behind)
    return difference / (2 * scale).reshape(-1, *(1,) * (difference.ndim - 1))
