"""Unscented Kalman filters for stochastic nonlinearities and measurements that come in turns.

    x' = f(x) + g(x, eta) + w,   y = h(x) + b(x, zeta) + v,   E{g g' | x} = sum_t Pi_t x' Gamma_t x

of y only some rows are transmitted per step; the receiver holds old values of the others. A filter
is a value of three functions. `RECOMMENDED` updates with what was transmitted: a held row is a
constant that the filter knows, with no innovation, no variance and no covariance with the state, so
it drops out.

Source: Meng et al. (2025), UKF for nonlinear systems with stochastic nonlinearities under FlexRay
protocol. Its points are `scaled_unscented(n, alpha, beta, kappa=0)`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import SigmaPointRule


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
    """Reception of a slot: values (..., m), fresh or held, and which are fresh (..., m)."""

    values: np.ndarray
    fresh: np.ndarray


class MeasurementFilter(NamedTuple):
    """A filter behind a measurement bus. Its state has a `belief`; leading axes are free.

    Attributes:
        start: (belief at the first instant, Observation then, rule) -> state.
        predict: (state, Dynamics, rule) -> state, one step later.
        update: (state, Received, Observation, rule) -> state.
    """

    start: Callable[[Gaussian, Observation, SigmaPointRule], Any]
    predict: Callable[[Any, Dynamics, SigmaPointRule], Any]
    update: Callable[[Any, Received, Observation, SigmaPointRule], Any]


def expected_cov(stochastic: SecondMoment, belief: Gaussian) -> np.ndarray:
    """E{g g'} (..., d, d) over a belief: sum_t Pi_t (x' Gamma_t x + tr(Gamma_t P))."""
    second = belief.mean[..., :, None] * belief.mean[..., None, :] + belief.cov
    sizes = np.einsum("tij,...ij->...t", stochastic.gamma, second)
    return np.einsum("...t,tij->...ij", sizes, stochastic.pi)


class State(NamedTuple):
    """The state of a filter on fresh rows."""

    belief: Gaussian


def on_fresh_rows(
    filter_with: Callable[[SigmaPointRule], Filter],
    moment: Callable[[SecondMoment, Gaussian], np.ndarray] = expected_cov,
) -> MeasurementFilter:
    """A filter made of a rule, behind a measurement bus: held rows are constants that it knows.

    The second moments of stochastic nonlinearities over the belief, of the step before in the
    prediction, are added to the noise: (10) to (13). An update draws its points anew, as in (14). A
    lane in which nothing is fresh keeps its belief.
    """

    def start(prior: Gaussian, observation: Observation, rule: SigmaPointRule) -> State:
        return State(prior)

    def predict(state: State, dynamics: Dynamics, rule: SigmaPointRule) -> State:
        belief, noise_cov = state.belief, dynamics.noise_cov
        noise_cov = noise_cov + moment(dynamics.stochastic, belief)
        return State(filter_with(rule).predict(belief, dynamics.transition, noise_cov))

    def update(
        state: State, received: Received, observation: Observation, rule: SigmaPointRule
    ) -> State:
        sent = np.where(received.fresh, received.values, np.nan)
        noise_cov = observation.noise_cov + moment(observation.stochastic, state.belief)
        found = filter_with(rule).update(state.belief, sent, observation.measure, noise_cov)
        return State(found.belief)

    return MeasurementFilter(start, predict, update)


RECOMMENDED = on_fresh_rows(SigmaPointFilter)
