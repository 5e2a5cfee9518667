"""Unscented Kalman filters for stochastic nonlinearities and measurements that come in turns.

    x' = f(x) + g(x, eta) + w,   y = h(x) + b(x, zeta) + v,   E{g g' | x} = sum_t Pi_t x' Gamma_t x

of y only some rows are transmitted per step; the receiver holds old values of the others. Three
filters, each a value of three functions on the same arguments:

- `RECOMMENDED` updates with what was transmitted. A held row is a constant that the filter knows:
  no innovation, no variance, no covariance with the state, so it drops out.
- `PAPER_LITERAL` is the algorithm of the paper as printed, with a pseudo-inverse: see its warning.
- `PAPER_LITERAL_R` is the same with measurement noise on every row.

Source: Meng et al. (2025), UKF for nonlinear systems with stochastic nonlinearities under FlexRay
protocol, equations (10) to (23). Its points are `scaled_unscented(n, alpha, beta, kappa=0)`.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from filters import ukf
from filters.gaussian import Gaussian
from filters.linalg import inverse_spd, multiply, symmetrise
from filters.moments import Model, evaluate, points_last
from filters.sigma_points import SigmaPointRule, sigma_points

# Eigenvalues below this part of the largest count as zero in a pseudo-inverse.
PSEUDO_INVERSE_CUTOFF = 1e-10

LITERAL_WARNING = (
    "paper-literal: Pyy of (19) is singular, its rank is at most 2n+1 however many rows are held; a "
    "pseudo-inverse is used, and the fresh sample receives zero gain. Use the recommended filter "
    "for any conclusion."
)
LITERAL_R_WARNING = (
    "paper-literal-R: noise on every row of (19) makes Pyy regular, but held measurements are "
    "taken as new ones again and again. Use the recommended filter for any conclusion."
)


class SecondMoment(Protocol):
    """sum_t pi_t x' gamma_t x with pi (terms, d, d) and gamma (terms, n, n); no terms: nothing."""

    @property
    def pi(self) -> np.ndarray: ...

    @property
    def gamma(self) -> np.ndarray: ...


class Dynamics(NamedTuple):
    """One step of the state: f on points, covariance Q (n, n), second moment of g."""

    transition: Model
    noise_cov: np.ndarray
    stochastic: SecondMoment


class Observation(NamedTuple):
    """One measurement of all sensors: h on points, covariance R (m, m), second moment of b."""

    measure: Model
    noise_cov: np.ndarray
    stochastic: SecondMoment


class Received(NamedTuple):
    """What came in a slot: values (..., m), fresh or held, and which are fresh (..., m)."""

    values: np.ndarray
    fresh: np.ndarray


class MeasurementFilter(NamedTuple):
    """A filter behind a measurement bus. Its state has a `belief`; leading axes are free.

    Attributes:
        start: (belief at the first instant, Observation then, rule) -> state.
        predict: (state, Dynamics, rule) -> state, one step later.
        update: (state, Received, Observation, rule) -> state.
        warning: what a user must be told before trusting it.
    """

    start: Callable[[Gaussian, Observation, SigmaPointRule], Any]
    predict: Callable[[Any, Dynamics, SigmaPointRule], Any]
    update: Callable[[Any, Received, Observation, SigmaPointRule], Any]
    warning: str = ""


def expected_cov(stochastic: SecondMoment, belief: Gaussian) -> np.ndarray:
    """E{g g'} (..., d, d) over a belief: sum_t Pi_t (x' Gamma_t x + tr(Gamma_t P))."""
    second = belief.mean[..., :, None] * belief.mean[..., None, :] + belief.cov
    sizes = np.einsum("tij,...ij->...t", stochastic.gamma, second)
    return np.einsum("...t,tij->...ij", sizes, stochastic.pi)


# --- recommended ---------------------------------------------------------------------------------


class State(NamedTuple):
    """The state of the recommended filter."""

    belief: Gaussian


def start(prior: Gaussian, observation: Observation, rule: SigmaPointRule) -> State:
    """The state before the first step."""
    return State(prior)


def predict(state: State, dynamics: Dynamics, rule: SigmaPointRule) -> State:
    """One step later: (10) to (13), E{g g'} over the belief at the step before."""
    noise_cov = dynamics.noise_cov + expected_cov(dynamics.stochastic, state.belief)
    return State(ukf.predict(state.belief, dynamics.transition, noise_cov, rule))


def update(
    state: State, received: Received, observation: Observation, rule: SigmaPointRule
) -> State:
    """After a slot: the update with the fresh rows alone, from points redrawn as in (14).

    A lane in which nothing is fresh keeps its belief.
    """
    sent = np.where(received.fresh, received.values, np.nan)
    noise_cov = observation.noise_cov + expected_cov(observation.stochastic, state.belief)
    return State(ukf.update(state.belief, sent, observation.measure, noise_cov, rule).belief)


# --- as printed ----------------------------------------------------------------------------------


class LiteralState(NamedTuple):
    """What the printed algorithm carries on.

    Attributes:
        belief: after the last half step.
        carried: chihat (S, ..., n) of (11), the points of before moved by f.
        outputs, output: phihat (S, ..., m) of (15) and yhat (..., m) of (16), one step old.
    """

    belief: Gaussian
    carried: np.ndarray
    outputs: np.ndarray
    output: np.ndarray


class LiteralMoments(NamedTuple):
    """yhat^f (..., m) of (18), Pyy (..., m, m) of (19) and Pxy (..., n, m) of (20)."""

    output: np.ndarray
    output_cov: np.ndarray
    cross_cov: np.ndarray


def literal_start(
    prior: Gaussian, observation: Observation, rule: SigmaPointRule
) -> LiteralState:
    """The state before the first step; phihat and yhat of before are those of the prior."""
    points = sigma_points(prior, rule)
    outputs, output = _outputs(points, observation, rule)
    return LiteralState(prior, points, outputs, output)


def literal_predict(
    state: LiteralState, dynamics: Dynamics, rule: SigmaPointRule
) -> LiteralState:
    """One step later: (10) to (13)."""
    points = sigma_points(state.belief, rule)
    carried = evaluate(dynamics.transition, points, points.shape[-1], "transition")
    noise_cov = dynamics.noise_cov + expected_cov(dynamics.stochastic, state.belief)
    return state._replace(
        belief=ukf.predict(state.belief, lambda _: carried, noise_cov, rule), carried=carried
    )


def literal_moments(
    state: LiteralState,
    outputs: np.ndarray,
    output: np.ndarray,
    fresh: np.ndarray,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
) -> LiteralMoments:
    """(17) to (20): fresh rows of outputs (S, ..., m) and output (..., m), held rows of before."""
    output = np.where(fresh, output, state.output)
    deviations = points_last(np.where(fresh, outputs, state.outputs) - output)
    weighted = rule.cov_weights[:, None] * deviations
    spread = points_last(state.carried - state.belief.mean)
    return LiteralMoments(
        output, symmetrise(weighted.mT @ deviations + noise_cov), spread.mT @ weighted
    )


def literal_update(
    invert: Callable[[np.ndarray], np.ndarray],
    noise_of: Callable[[np.ndarray, np.ndarray], np.ndarray],
    state: LiteralState,
    received: Received,
    observation: Observation,
    rule: SigmaPointRule,
) -> LiteralState:
    """(14) to (23) as printed.

    `invert` stands for the inverse in (23); `noise_of(E{b b'} + R (..., m, m), fresh (..., m))` for
    N(.)N' in (19).
    """
    outputs, output = _outputs(sigma_points(state.belief, rule), observation, rule)
    noise_cov = observation.noise_cov + expected_cov(observation.stochastic, state.belief)
    noise_cov = noise_of(noise_cov, received.fresh)
    moments = literal_moments(state, outputs, output, received.fresh, noise_cov, rule)
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


RECOMMENDED = MeasurementFilter(start, predict, update)
PAPER_LITERAL = MeasurementFilter(
    literal_start,
    literal_predict,
    partial(literal_update, pseudo_inverse, on_fresh_rows),
    LITERAL_WARNING,
)
PAPER_LITERAL_R = MeasurementFilter(
    literal_start,
    literal_predict,
    partial(literal_update, inverse_spd, on_all_rows),
    LITERAL_R_WARNING,
)
FILTERS = {
    "recommended": RECOMMENDED,
    "paper-literal": PAPER_LITERAL,
    "paper-literal-R": PAPER_LITERAL_R,
}
