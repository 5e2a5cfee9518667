"""The unscented Kalman filter under the FlexRay protocol as it is printed, and with one repair.

`PAPER_LITERAL` cannot run as printed: Pyy in (19) is singular. It takes a pseudo-inverse, and is
there to show what that gives. `PAPER_LITERAL_R` has measurement noise on every
row, which makes Pyy regular. For anything else there is
`concord.features.measurement_bus.stochastic_ukf.RECOMMENDED`.

Source: Meng et al. (2025), UKF for nonlinear systems with stochastic nonlinearities under FlexRay
protocol, equations (10) to (23).
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.stochastic_ukf import (
    Dynamics,
    MeasurementFilter,
    Observation,
    Received,
    expected_cov,
)
from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import inverse_spd, multiply, symmetrise
from concord.filters.moments import evaluate, points_last
from concord.filters.sigma_points import SigmaPointRule, sigma_points

# Eigenvalues below this part of the largest count as zero in a pseudo-inverse.
PSEUDO_INVERSE_CUTOFF = 1e-10


class PrintedState(NamedTuple):
    """State of the printed algorithm between two steps.

    Attributes:
        belief: after the last half step.
        carried: chihat (S, ..., n) of (11), the previous points moved by f.
        outputs, output: phihat (S, ..., m) of (15) and yhat (..., m) of (16), one step old.
    """

    belief: Gaussian
    carried: np.ndarray
    outputs: np.ndarray
    output: np.ndarray


class PrintedMoments(NamedTuple):
    """yhat^f (..., m) of (18), Pyy (..., m, m) of (19) and Pxy (..., n, m) of (20)."""

    output: np.ndarray
    output_cov: np.ndarray
    cross_cov: np.ndarray


def start(prior: Gaussian, observation: Observation, rule: SigmaPointRule) -> PrintedState:
    """The state before the first step; phihat and yhat of before are those of the prior."""
    points = sigma_points(prior, rule)
    outputs, output = _outputs(points, observation, rule)
    return PrintedState(prior, points, outputs, output)


def predict(state: PrintedState, dynamics: Dynamics, rule: SigmaPointRule) -> PrintedState:
    """One step later: (10) to (13)."""
    points = sigma_points(state.belief, rule)
    carried = evaluate(dynamics.transition, points, points.shape[-1], "transition")
    noise_cov = dynamics.noise_cov + expected_cov(dynamics.stochastic, state.belief)
    return state._replace(
        belief=ukf.predict(state.belief, lambda _: carried, noise_cov, rule), carried=carried
    )


def printed_moments(
    state: PrintedState,
    outputs: np.ndarray,
    output: np.ndarray,
    fresh: np.ndarray,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
) -> PrintedMoments:
    """(17) to (20): fresh rows of outputs (S, ..., m) and output (..., m), held rows of before."""
    output = np.where(fresh, output, state.output)
    deviations = points_last(np.where(fresh, outputs, state.outputs) - output)
    weighted = rule.cov_weights[:, None] * deviations
    spread = points_last(state.carried - state.belief.mean)
    return PrintedMoments(
        output, symmetrise(weighted.mT @ deviations + noise_cov), spread.mT @ weighted
    )


def update(
    invert: Callable[[np.ndarray], np.ndarray],
    noise_of: Callable[[np.ndarray, np.ndarray], np.ndarray],
    state: PrintedState,
    received: Received,
    observation: Observation,
    rule: SigmaPointRule,
) -> PrintedState:
    """(14) to (23) as printed.

    `invert` stands for the inverse in (23); `noise_of(E{b b'} + R (..., m, m), fresh (..., m))` for
    N(.)N' in (19).
    """
    outputs, output = _outputs(sigma_points(state.belief, rule), observation, rule)
    noise_cov = observation.noise_cov + expected_cov(observation.stochastic, state.belief)
    noise_cov = noise_of(noise_cov, received.fresh)
    moments = printed_moments(state, outputs, output, received.fresh, noise_cov, rule)
    gain = moments.cross_cov @ invert(moments.output_cov)
    after = Gaussian(
        state.belief.mean + multiply(gain, received.values - moments.output),
        symmetrise(state.belief.cov - gain @ moments.output_cov @ gain.mT),
    )
    return state._replace(belief=after, outputs=outputs, output=output)


def on_fresh_rows(noise_cov: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """N (.) N' of (19): noise where both rows are fresh."""
    return np.where(fresh[..., :, None] & fresh[..., None, :], noise_cov, 0.0)


def on_all_rows(noise_cov: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Noise on held rows too."""
    return noise_cov


def pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Moore-Penrose inverse (..., m, m) of symmetric matrices; a lane with a NaN is NaN."""
    sound = np.isfinite(matrix).all(axis=(-1, -2), keepdims=True)
    safe = np.where(sound, matrix, np.eye(matrix.shape[-1]))
    inverse = np.linalg.pinv(safe, rcond=PSEUDO_INVERSE_CUTOFF, hermitian=True)
    return np.where(sound, inverse, np.nan)


def _outputs(
    points: np.ndarray, observation: Observation, rule: SigmaPointRule
) -> tuple[np.ndarray, np.ndarray]:
    """(15) and (16)."""
    m = observation.noise_cov.shape[-1]
    outputs = evaluate(observation.measure, points, m, "measure")
    return outputs, rule.mean_weights @ points_last(outputs)


PAPER_LITERAL = MeasurementFilter(start, predict, partial(update, pseudo_inverse, on_fresh_rows))
PAPER_LITERAL_R = MeasurementFilter(start, predict, partial(update, inverse_spd, on_all_rows))
