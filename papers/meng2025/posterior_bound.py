"""The posterior Cramer-Rao bound of the example, whose noise grows with the state.

Given a state x, the next one is normal with mean f(x) and covariance Q + Pi x' Gamma x, and so is a
measurement. The information about x is thus J' S^-1 J + tr(S^-1 Pi S^-1 Pi) d d' / 2, where J is
the Jacobian of the mean and d = 2 Gamma x the gradient of x' Gamma x. Expectations are means over
runs, with the sensors that sent in each run. The bound leaves out what a contention tells of its
losers.

Source: Tichavsky, Muravchik, Nehorai (1998), Posterior Cramer-Rao bounds for discrete-time
nonlinear filtering, IEEE Transactions on Signal Processing 46, equation (21).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.meng2025 import SYSTEM
from concord.features.measurement_bus.stochastic import NoiseSecondMoment
from concord.papers.meng2025.runs import MeasuredBatch

_STEP = 1e-4


class FisherInformation(NamedTuple):
    """Fisher information of a normal vector with mean m(x) and covariance S(x), (R, ...) each.

    own: of x, (R, n, n). cross: J' S^-1 (R, n, d). inverse: S^-1 (R, d, d).
    """

    own: np.ndarray
    cross: np.ndarray
    inverse: np.ndarray


def bound_of(batch: MeasuredBatch, fresh: np.ndarray) -> np.ndarray:
    """Bound (S, n) of the mean square error of each state at the steps 1..S.

    fresh: (S, R, m), the measurements that were sent.
    """
    information = np.linalg.inv(meng2025.PRIOR_COV)
    bounds = []
    for step in range(1, len(batch.truth)):
        before, now = batch.truth[step - 1], batch.truth[step]
        moved = _information(
            lambda x, at=step - 1: SYSTEM.transition(x, None, at),
            before, SYSTEM.process_noise_cov(step - 1), SYSTEM.process_moment(step - 1),
        )  # fmt: skip
        own, cross, last = (one.mean(axis=0) for one in moved)
        carried = last - cross.T @ np.linalg.solve(information + own, cross)
        seen = _seen(now, step, fresh[step - 1])
        information = carried + seen.mean(axis=0)
        bounds.append(np.diagonal(np.linalg.inv(information)))
    return np.array(bounds)


def _seen(state: np.ndarray, step: int, fresh: np.ndarray) -> np.ndarray:
    """Information (R, n, n) of the measurements that were sent, (R, m)."""
    found = np.zeros((*state.shape, state.shape[-1]))
    noise, moment = SYSTEM.measurement_noise_cov(step), SYSTEM.measurement_moment(step)
    for sent in np.unique(fresh, axis=0):
        rows = np.flatnonzero(sent)
        if len(rows):
            which = (fresh == sent).all(axis=-1)
            some = NoiseSecondMoment(moment.pi[:, rows][:, :, rows], moment.gamma)
            found[which] = _information(
                lambda x, rows=rows: SYSTEM.measure(x, step)[..., rows],
                state[which], noise[rows][:, rows], some,
            ).own  # fmt: skip
    return found


def _information(
    mean: Callable[[np.ndarray], np.ndarray],
    state: np.ndarray,
    noise_cov: np.ndarray,
    moment: NoiseSecondMoment,
) -> FisherInformation:
    steps = _STEP * np.eye(state.shape[-1])
    # Central differences: exact but for rounding, as f is linear and h of second degree.
    jacobian = np.stack([(mean(state + h) - mean(state - h)) / (2 * _STEP) for h in steps], -1)
    ((pi, gamma),) = zip(*moment, strict=True)
    gradient = 2.0 * state @ gamma
    size = np.einsum("ri,ij,rj->r", state, gamma, state)
    inverse = np.linalg.inv(noise_cov + size[:, None, None] * pi)
    spread = inverse @ pi
    of_cov = 0.5 * np.einsum("rij,rji->r", spread, spread)
    cross = jacobian.mT @ inverse
    own = cross @ jacobian + of_cov[:, None, None] * gradient[:, :, None] * gradient[:, None, :]
    return FisherInformation(own, cross, inverse)
