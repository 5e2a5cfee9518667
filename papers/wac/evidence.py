"""Measure the consensus paper's formulas, as printed and as corrected."""

from typing import NamedTuple

import numpy as np

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.continuous import ContinuousPlant
from concord.features.control.design import controllability_rank, observability_rank
from concord.features.control.networks import PAPER_PRIOR_VARIANCE
from concord.features.control.transfer_functions import Rational, root_locus, series
from concord.papers.wac.exact import Exact
from concord.papers.wac.loops import Loops
from concord.papers.wac.responses import OUTPUT, Trial, rmse
from concord.papers.wac.root_loci import figure_7
from concord.papers.wac.unstable import UnstableOutcome
from concord.topology.graphs import path, ring
from concord.topology.weights import equal_neighbour, metropolis

OUTPUT_NOISE = 1.0  # R of pitch and motors in the paper's table
LQR_WEIGHT = 50.0  # its p


class WacEvidence(NamedTuple):
    """Numbers about the paper, each named for what it is; see `gather` for how they come about."""

    loops: Loops
    bus_realisation_error: float
    bus_travel_row: tuple[float, ...]
    bus_travel_away: float
    speed_gain_printed: float
    speed_gain: float
    speed_gain_ratio: float
    full_ranks: int
    plants: int
    lag_loop_error: float
    rightmost_poles: dict[str, float]
    printed_noise_gains: dict[str, tuple[float, ...]]
    prior_away_from_riccati: float
    rest_error_m_s: float
    limit_away_from_first_weight: float
    limit_away_from_average: float
    wac_rmse_least: float
    wac_rmse_most: float
    wac_lambda_max: float
    radii: tuple[float, ...]
    blind_rmse_to_measured: dict[str, float]
    hidden_rmse_to_spread: float


def gather(
    loops: Loops, exact: Exact, unstable: list[UnstableOutcome], trials: dict[str, dict[str, Trial]]
) -> WacEvidence:
    """Everything, from what other parts of the reproduction measured and from formulas."""
    wac = np.concatenate([rules["wac"][..., 0].ravel() for rules in exact.after.values()])
    return WacEvidence(
        loops=loops,
        **_plants(),
        **_controllers(),
        **_filter(),
        **_consensus(),
        wac_rmse_least=float(wac.min()),
        wac_rmse_most=float(wac.max()),
        wac_lambda_max=max(float(rules["wac"].max()) for rules in exact.worst.values()),
        radii=tuple(max(o.mean_radius, o.cov_radius) for o in unstable),
        blind_rmse_to_measured={
            name: max(
                rmse(trial, trial.estimated[:, OUTPUT[name]], OUTPUT[name])
                / rmse(trial, trial.measured, OUTPUT[name])
                for trial in of_plant.values()
            )
            for name, of_plant in trials.items()
        },
        hidden_rmse_to_spread=max(
            rmse(trial, trial.estimated[:, 0], 0) / float(trial.truth[:, 0].std())
            for trial in trials["pitch"].values()
        ),
    )


def _plants() -> dict:
    travel = suspension.dynamics().state_matrix[2]
    printed = _speed_gain(-motor.RESISTANCE_OHM / motor.INERTIA_KG_M2)
    actual = _speed_gain(-motor.RESISTANCE_OHM / motor.INDUCTANCE_H)
    return {
        "bus_realisation_error": _realisation_error(),
        "bus_travel_row": tuple(travel.tolist()),
        # Of dy1/dt = x4, if the states were x1, y1 and their derivatives.
        "bus_travel_away": float(np.abs(travel - [0.0, 0.0, 0.0, 1.0]).max()),
        "speed_gain_printed": printed,
        "speed_gain": actual,
        "speed_gain_ratio": printed / actual,
        "full_ranks": sum(_full_rank(plant) for plant in _all_dynamics()),
        "plants": len(_all_dynamics()),
    }


def _all_dynamics() -> list[ContinuousPlant]:
    return [
        cruise.dynamics(),
        suspension.dynamics(),
        pitch.dynamics(),
        motor.speed_dynamics(),
        motor.position_dynamics(),
    ]


def _full_rank(plant: ContinuousPlant) -> bool:
    n = len(plant.state_matrix)
    controllable = controllability_rank(plant.state_matrix, plant.control_matrix) == n
    return controllable and observability_rank(plant.state_matrix, plant.output_row) == n


def _realisation_error() -> float:
    """Largest relative difference of (9) from both transfer functions of (7) on the axis."""
    plant = suspension.dynamics()
    inputs = (plant.control_matrix, plant.disturbance_matrix)
    errors = []
    for printed, column in zip(suspension.transfer_functions(), inputs, strict=True):
        for frequency in np.geomspace(0.01, 1000, 60):
            s = 1j * frequency
            state = np.linalg.solve(s * np.eye(4) - plant.state_matrix, column)
            errors.append(abs((plant.output_row @ state)[0, 0] / printed(s) - 1))
    return float(max(errors))


def _speed_gain(electrical_pole: float) -> float:
    """Speed per volt at rest, rad/s/V, with the last entry of the matrix of (21) as given."""
    plant = motor.speed_dynamics()
    matrix = plant.state_matrix.copy()
    matrix[1, 1] = electrical_pole
    return float((plant.output_row @ np.linalg.solve(-matrix, plant.control_matrix))[0, 0])


def _controllers() -> dict:
    loop = series(cruise.LAG, cruise.transfer_function())
    ours = np.polyadd(loop.denominator, loop.numerator)
    # (26): m s^2 + (b + m p0 + Kp) s + (b p0 + Kp z0).
    gain, zero, pole = (
        cruise.LAG.numerator[0],
        _root(cruise.LAG.numerator),
        _root(cruise.LAG.denominator),
    )
    mass, damping = cruise.MASS_KG, cruise.DAMPING_N_S_PER_M
    printed = [mass, damping - mass * pole + gain, -damping * pole - gain * zero]
    designs = {
        panel.title: panel.loop for letter, panel in figure_7().items() if letter not in "cde"
    }
    return {
        "lag_loop_error": float(np.abs(ours / np.array(printed) - 1).max()),
        "rightmost_poles": {title: _rightmost_pole(loop) for title, loop in designs.items()},
    }


def _root(coefficients: tuple[float, ...]) -> float:
    return float(np.roots(coefficients)[0].real)


def _rightmost_pole(loop: Rational) -> float:
    """Largest real part in 1/s of the poles of the loop closed with gain 1."""
    return float(root_locus(loop, np.array([0.0, 1.0]))[1].real.max())


def _filter() -> dict:
    gains = {}
    for name, plant in (("pitch", pitch.dynamics()), ("position", motor.position_dynamics())):
        transition, _ = plant.sampled(0.01)
        row = plant.output_row
        noise = LQR_WEIGHT * row.T @ row
        gain, _ = _steady_gain(transition, row, noise, OUTPUT_NOISE)
        gains[name] = tuple(gain[:, 0].tolist())
    speed = motor.speed_dynamics()
    transition, _ = speed.sampled(0.01)
    row = speed.output_row
    _, riccati = _steady_gain(transition, row, LQR_WEIGHT * row.T @ row, OUTPUT_NOISE)
    wanted = PAPER_PRIOR_VARIANCE * np.eye(2)
    return {
        "printed_noise_gains": gains,
        "prior_away_from_riccati": float(
            np.linalg.norm(wanted - riccati) / np.linalg.norm(riccati)
        ),
        "rest_error_m_s": _rest_error(),
    }


def _steady_gain(
    transition: np.ndarray, row: np.ndarray, noise_cov: np.ndarray, variance: float
) -> tuple[np.ndarray, np.ndarray]:
    """The gain (n, 1) of the filter that believes these, settled, and its predicted covariance."""
    from scipy.linalg import solve_discrete_are

    cov = solve_discrete_are(transition.T, row.T, noise_cov, np.array([[variance]]))
    return cov @ row.T / (row @ cov @ row.T + variance), cov


def _rest_error() -> float:
    """Standard deviation that the error of the cruise filter keeps with the paper's Q and R, in
    m/s, on a truth without process noise, as the paper has it."""
    transition, _ = cruise.dynamics().sampled(cruise.TIME_STEP_S)
    gain, _ = _steady_gain(transition, np.eye(1), np.array([[0.1]]), 0.5)
    kept = (1 - gain[0, 0]) * transition[0, 0]
    return float(np.sqrt(gain[0, 0] ** 2 * 0.5 / (1 - kept**2)))


def _consensus() -> dict:
    """The limit of (30) on a path, whose row-stochastic weights are not doubly stochastic."""
    limit = np.linalg.matrix_power(equal_neighbour(path(8)).toarray(), 5000)
    balanced = np.linalg.matrix_power(metropolis(ring(8)).toarray(), 5000)
    return {
        "limit_away_from_first_weight": float(np.abs(limit[0] - limit[0, 0]).max()),
        "limit_away_from_average": float(np.abs(balanced - 1 / 8).max()),
    }
