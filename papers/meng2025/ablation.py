"""One erratum at a time: the recommended filter with a single formula as printed, and the EKF."""

from dataclasses import replace

import numpy as np

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.measurement_bus import flexray
from concord.features.measurement_bus.meng2025 import SENSORS, SYSTEM
from concord.features.measurement_bus.stochastic import StochasticSystem
from concord.features.measurement_bus.stochastic_ukf import (
    RECOMMENDED,
    MeasurementFilter,
    Observation,
    Received,
    SecondMoment,
    State,
    expected_cov,
    on_fresh_rows,
)
from concord.filters.extended import ExtendedFilter
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import inverse_spd, multiply, symmetrise
from concord.filters.moments import evaluate, points_last
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import SigmaPointRule, sigma_points
from concord.papers.meng2025 import filter_as_printed
from concord.papers.meng2025.filter_as_printed import PrintedState
from concord.papers.meng2025.runs import ComparedMethod


def ablations() -> dict[str, ComparedMethod]:
    """The compared methods; each differs from the recommended filter in what its label says."""
    bus = flexray(SENSORS, meng2025.STATIC_SLOTS)
    stale = MeasurementFilter(RECOMMENDED.start, RECOMMENDED.predict, _take_held_values)
    carried = MeasurementFilter(filter_as_printed.start, filter_as_printed.predict, _pair_carried)
    rough = on_fresh_rows(SigmaPointFilter, _at_mean)
    extended = on_fresh_rows(lambda _: ExtendedFilter())
    return {
        "erratum 2": ComparedMethod("held values taken for fresh ones (errata 2, 3)", bus, stale),
        "erratum 4": ComparedMethod("(20) as printed (erratum 4)", bus, carried),
        "erratum 6": ComparedMethod("E(g g') and E(b b') at the mean (erratum 6)", bus, rough),
        "erratum 10, h": ComparedMethod("h one step early (erratum 10)", bus, system=_early(1, 0)),
        "erratum 10, f": ComparedMethod("f one step late (erratum 10)", bus, system=_early(0, 1)),
        "ekf": ComparedMethod("extended Kalman filter", bus, extended),
    }


def _take_held_values(
    state: State, received: Received, observation: Observation, rule: SigmaPointRule
) -> State:
    everything = Received(received.values, np.ones_like(received.fresh))
    return RECOMMENDED.update(state, everything, observation, rule)


def _pair_carried(
    state: PrintedState, received: Received, observation: Observation, rule: SigmaPointRule
) -> PrintedState:
    """The fresh rows alone, with the covariance between carried points and redrawn ones."""
    m = observation.noise_cov.shape[-1]
    points = sigma_points(state.belief, rule)
    outputs = evaluate(observation.measure, points, m, "measure")
    output = rule.mean_weights @ points_last(outputs)
    fresh = received.fresh
    deviations = np.where(fresh[..., None, :], points_last(outputs - output), 0.0)
    weighted = rule.cov_weights[:, None] * deviations
    noise_cov = observation.noise_cov + expected_cov(observation.stochastic, state.belief)
    both = fresh[..., :, None] & fresh[..., None, :]
    # Rows that are not fresh get a variance of their own, and no covariance.
    noise_cov = np.where(both, noise_cov, np.eye(m))
    output_cov = symmetrise(weighted.mT @ deviations + noise_cov)
    gain = points_last(state.carried - state.belief.mean).mT @ weighted @ inverse_spd(output_cov)
    innovation = np.where(fresh, received.values - output, 0.0)
    after = Gaussian(
        state.belief.mean + multiply(gain, innovation),
        symmetrise(state.belief.cov - gain @ output_cov @ gain.mT),
    )
    return state._replace(belief=after)


def _at_mean(stochastic: SecondMoment, belief: Gaussian) -> np.ndarray:
    return expected_cov(stochastic, Gaussian(belief.mean, np.zeros_like(belief.cov)))


def _early(measured: int, moved: int) -> StochasticSystem:
    """The example, whose h is taken so many steps early and whose f so many late."""
    return replace(
        SYSTEM,
        transition=lambda state, control, step: SYSTEM.transition(state, control, step + moved),
        measure=lambda state, step: SYSTEM.measure(state, step - measured),
    )
