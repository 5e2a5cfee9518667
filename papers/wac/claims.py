"""The claims of the consensus paper, each beside what was measured, and the study's errata."""

from types import SimpleNamespace

import numpy as np

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.continuous import ContinuousPlant
from concord.features.control.design import controllability_rank, observability_rank
from concord.features.control.networks import PAPER_PRIOR_VARIANCE
from concord.features.control.transfer_functions import root_locus, series
from concord.papers.kit.judging import Claim, ClaimFinding, NamedFigures, errata_from, needs
from concord.papers.wac.exact import Exact
from concord.papers.wac.figures import WITHOUT_DESIGN
from concord.papers.wac.loops import figure_7
from concord.papers.wac.responses import OUTPUT, Trial, rmse
from concord.papers.wac.unstable import UnstableOutcome
from concord.topology.graphs import path, ring
from concord.topology.weights import equal_neighbour, metropolis

# Relative differences and weights that are equal but for rounding.
_ROUNDING = 1e-9
# The band in which a step response counts as settled, of the nominal speed.
_SETTLED = 0.02
# An estimate that is "almost identical" to another, as a ratio of RMSE.
_ALMOST = 1.05
# Least gain of a filter that corrects a state at all.
_CORRECTED = 0.01
OUTPUT_NOISE = 1.0  # R of pitch and motors in the paper's table
LQR_WEIGHT = 50.0  # its p


def gather(
    loops: NamedFigures,
    exact: Exact,
    unstable: list[UnstableOutcome],
    trials: dict[str, dict[str, Trial]],
) -> NamedFigures:
    """The figures that the claims need: from other parts of the reproduction, and from formulas."""
    rmse_to_central = np.concatenate([last[..., 0].ravel() for last, _ in exact.values()])
    # The limit of (30) on a path, whose row-stochastic weights are not doubly stochastic.
    limit = np.linalg.matrix_power(equal_neighbour(path(8)).toarray(), 5000)
    balanced = np.linalg.matrix_power(metropolis(ring(8)).toarray(), 5000)
    return {
        **loops,
        **_plants(),
        **_controllers(),
        **_filter(),
        "limit_away_from_first_weight": float(np.abs(limit[0] - limit[0, 0]).max()),
        "limit_away_from_average": float(np.abs(balanced - 1 / 8).max()),
        "wac_rmse_least": float(rmse_to_central.min()),
        "wac_rmse_most": float(rmse_to_central.max()),
        "wac_lambda_max": max(float(worst.max()) for _, worst in exact.values()),
        "radii": tuple(max(o.mean_radius, o.cov_radius) for o in unstable),
        "blind_rmse_to_measured": {
            name: max(
                rmse(trial, trial.estimated[:, OUTPUT[name]], OUTPUT[name])
                / rmse(trial, trial.measured, OUTPUT[name])
                for trial in of_plant.values()
            )
            for name, of_plant in trials.items()
        },
        "hidden_rmse_to_spread": max(
            rmse(trial, trial.estimated[:, 0], 0) / float(trial.truth[:, 0].std())
            for trial in trials["pitch"].values()
        ),
    }


def _plants() -> NamedFigures:
    plants = (cruise, suspension, pitch)
    every = [*(one.dynamics() for one in plants), motor.speed_dynamics(), motor.position_dynamics()]
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
        "full_ranks": sum(_full_rank(plant) for plant in every),
        "plants": len(every),
    }


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


def _controllers() -> NamedFigures:
    loop = series(cruise.LAG, cruise.transfer_function())
    ours = np.polyadd(loop.denominator, loop.numerator)
    # (26): m s^2 + (b + m p0 + Kp) s + (b p0 + Kp z0).
    gain = cruise.LAG.numerator[0]
    zero, pole = (
        float(np.roots(part)[0].real) for part in (cruise.LAG.numerator, cruise.LAG.denominator)
    )
    mass, damping = cruise.MASS_KG, cruise.DAMPING_N_S_PER_M
    printed = [mass, damping - mass * pole + gain, -damping * pole - gain * zero]
    return {
        "lag_loop_error": float(np.abs(ours / np.array(printed) - 1).max()),
        # Largest real part in 1/s of the poles of each loop closed with gain 1.
        "rightmost_poles": {
            panel.title: float(root_locus(panel.loop, np.array([0.0, 1.0]))[1].real.max())
            for letter, panel in figure_7().items()
            if letter not in WITHOUT_DESIGN
        },
    }


def _filter() -> NamedFigures:
    gains, cov = {}, np.eye(2)
    plants = {
        "pitch": pitch.dynamics(),
        "position": motor.position_dynamics(),
        "speed": motor.speed_dynamics(),  # last: its covariance is compared
    }
    for name, plant in plants.items():
        row = plant.output_row
        noise = LQR_WEIGHT * row.T @ row
        gain, cov = _steady_gain(plant.sampled(0.01)[0], row, noise, OUTPUT_NOISE)
        gains[name] = tuple(gain[:, 0].tolist())
    away = PAPER_PRIOR_VARIANCE * np.eye(2) - cov
    # The cruise filter with the paper's Q and R on a truth without process noise, as the paper has.
    transition, _ = cruise.dynamics().sampled(cruise.TIME_STEP_S)
    gain, _ = _steady_gain(transition, np.eye(1), np.array([[0.1]]), 0.5)
    kept = (1 - gain[0, 0]) * transition[0, 0]
    return {
        "printed_noise_gains": {name: gains[name] for name in ("pitch", "position")},
        "prior_away_from_riccati": float(np.linalg.norm(away) / np.linalg.norm(cov)),
        # Standard deviation that the error keeps, in m/s.
        "rest_error_m_s": float(np.sqrt(gain[0, 0] ** 2 * 0.5 / (1 - kept**2))),
    }


def _steady_gain(
    transition: np.ndarray, row: np.ndarray, noise_cov: np.ndarray, variance: float
) -> tuple[np.ndarray, np.ndarray]:
    """The gain (n, 1) of the filter that believes these, settled, and its predicted covariance."""
    from scipy.linalg import solve_discrete_are

    cov = solve_discrete_are(transition.T, row.T, noise_cov, np.array([[variance]]))
    return cov @ row.T / (row @ cov @ row.T + variance), cov


# --- the claims -----------------------------------------------------------------------------------


def judge(evidence: NamedFigures) -> list[Claim]:
    """All claims that can be measured, in the order of the paper."""
    e = SimpleNamespace(**evidence)
    parts = (_of_plants, _of_feedback, _of_classical, _of_filters, _of_consensus)
    return [claim for part in parts for claim in part(e)]


def _equal(figure: float, expected: float, tolerance: float) -> ClaimFinding:
    return needs(figure, at_least=expected - tolerance, at_most=expected + tolerance)


def _of_plants(e: SimpleNamespace) -> list[Claim]:
    row = ", ".join(f"{entry:.4g}" for entry in e.bus_travel_row)
    return [
        Claim("(7), (9)", "the state space (9) has the transfer functions (7)",
            [needs(e.bus_realisation_error, at_most=_ROUNDING)],
            f"largest relative difference {e.bus_realisation_error:.1g}"),
        Claim("after (7)", "the states are x1, y1 and their derivatives",
            [needs(e.bus_travel_away, at_most=_ROUNDING)],
            f"dy1/dt = [{row}] x + ..., not [0, 0, 0, 1] x. Correct: y2 = dy1/dt - (b2/M2) x1 + "
            "s y1 + (b2/M2) gamma with s = b1/M1 + b1/M2 + b2/M2", 2),
        Claim("(21)", "the last entry of the motor's matrix is -R/J",
            [_equal(e.speed_gain_ratio, 1.0, 0.01)],
            f"then 1 V gives {e.speed_gain_printed:.4f} rad/s, and (20) {e.speed_gain:.4f}. "
            "Correct: -R/L", 7, "print against print"),
        Claim("III", "controllability and observability matrices have full rank",
            [needs(e.full_ranks, at_least=e.plants)],
            f"{e.full_ranks} of {e.plants} plants from the controlled output"),
    ]  # fmt: skip


def _of_feedback(e: SimpleNamespace) -> list[Claim]:
    degrees = [57.29578 * angle for angle in (e.pitch_small_elevator, e.pitch_large_elevator)]
    return [
        Claim("Fig. 10, III",
            "with the pole -1.5 the car follows 10 m/s for 30 s and 7 m/s for 20 s",
            [
                needs(e.cruise_first.settling_time_s, at_most=30),
                needs(e.cruise_second.settling_time_s, at_most=20),
            ],
            f"settled (2 %) after {e.cruise_first.settling_time_s:.2f} s and "
            f"{e.cruise_second.settling_time_s:.2f} s, starting with "
            f"{e.cruise_start_kn:.0f} kN"),
        Claim("VI", "the nominal control is 500 N",
            [_equal(e.cruise_limited_speed, 10.0, 10.0 * _SETTLED)],
            f"limited to 500 N the car has {e.cruise_limited_speed:.2f} m/s after 30 s. "
            "Correct: 500 N hold 10 m/s at rest; N-bar r = 15 kN at the start", 9),
        Claim("Fig. 11, III", "the suspension's control brings y1 to rest in less than 5 s",
            [
                needs(e.bus_settling_s, at_most=5.0),
                needs(e.bus_open_beyond_5_mm_s, at_most=5.0),
            ],
            "no gain is printed, so it may be any. With the University of Michigan's, y1 stays "
            f"below 2 % of its peak after {e.bus_settling_s:.2f} s, with "
            f"{e.bus_force_mn:.1f} MN; with none it is beyond 5 mm until "
            f"{e.bus_open_beyond_5_mm_s:.1f} s", test="any open choice"),
        Claim("Fig. 12, VI", "the pitch follows .2 and .5 within 7 s",
            [needs(step.settling_time_s, at_most=7.0) for step in (e.pitch_small, e.pitch_large)],
            f"with p = 50 settled after {e.pitch_small.settling_time_s:.2f} s, overshoot "
            f"{e.pitch_small.overshoot_percent:.1f} %; the elevator would have to turn by "
            f"{degrees[0]:.0f} and {degrees[1]:.0f} degrees"),
        Claim("Fig. 13, III", "the motor's speed follows with poles -5 +- i",
            [
                needs(e.speed_step.settling_time_s, at_most=1.5),
                needs(e.speed_step.overshoot_percent, at_most=1.0),
            ],
            f"settled after {e.speed_step.settling_time_s:.2f} s, overshoot "
            f"{e.speed_step.overshoot_percent:.1f} %"),
        Claim("Fig. 14, III",
            "the motor's position follows with poles -100 +- 100i, -200 at t_s = .01 s",
            [needs(e.position_largest_pole, at_most=1.0)],
            f"unstable: largest |z| = {e.position_largest_pole:.2f}. Correct: place "
            f"exp(p t_s); that settles in {e.position_fast.settling_time_s:.2f} s with "
            f"{e.position_fast_kv:.0f} kV per rad. These poles belong to another motor", 8),
    ]  # fmt: skip


def _of_classical(e: SimpleNamespace) -> list[Claim]:
    return [
        Claim("Fig. 7", "P, PI, PID, lag, lead and notch controllers stabilise the plants",
            [needs(pole, at_most=0.0) for pole in e.rightmost_poles.values()],
            "no compensator is printed; tried with the tutorial's and this project's, of which "
            f"{sum(pole < 0 for pole in e.rightmost_poles.values())} of {len(e.rightmost_poles)} "
            "are stable at their own gain", test="any open choice"),
        Claim("(26)",
            "closed with a lag compensator, the car has m s² + (b + m p0 + Kp) s + b p0 + Kp z0",
            [needs(e.lag_loop_error, at_most=_ROUNDING)],
            f"coefficients equal to {e.lag_loop_error:.1g}; the label V/U is V/R (erratum 10)"),
    ]  # fmt: skip


def _of_filters(e: SimpleNamespace) -> list[Claim]:
    gains = "; ".join(
        # Adding zero rids a rounded -0 of its sign.
        f"{plant} " + ", ".join(f"{round(gain, 3) + 0.0:.3f}" for gain in entries)
        for plant, entries in e.printed_noise_gains.items()
    )
    hidden = (*e.printed_noise_gains["pitch"][:2], *e.printed_noise_gains["position"][1:])
    return [
        Claim("table of VI", "Q = p H'H and R = 1 touch the hidden states",
            [needs(max(map(abs, hidden)), at_least=_CORRECTED)],
            f"gains {gains}: the measured state is nearly replaced, hidden ones are not corrected. "
            "They are the weights of the LQR. Correct: Q of the physical noise (noise='matched')",
            19),
        Claim("VI", "P0 = 50 I solves the algebraic Riccati equation",
            [needs(e.prior_away_from_riccati, at_most=0.01)],
            f"for the motor's speed it is {100 * e.prior_away_from_riccati:.0f} % away from the "
            "solution", 20),
        Claim("Fig. 10b", "the error converges to zero",
            [needs(e.rest_error_m_s, at_most=1e-3)],
            f"with the Q and R printed it keeps a standard deviation of {e.rest_error_m_s:.2f} m/s "
            "at a node alone, on a truth without process noise"),
    ]  # fmt: skip


def _of_consensus(e: SimpleNamespace) -> list[Claim]:
    diverging = sum(radius > 1 for radius in e.radii)
    ratios = ", ".join(f"{plant} {ratio:.2f}" for plant, ratio in e.blind_rmse_to_measured.items())
    return [
        Claim("after (30)", "in the limit all nodes enter with the weight v1",
            [needs(e.limit_away_from_first_weight, at_most=_ROUNDING)],
            "equal-neighbour weights on a path: the limit's weights differ by up to "
            f"{e.limit_away_from_first_weight:.3f}. Correct: sum of v_j x_j; v = 1/N only for "
            "doubly stochastic weights (Metropolis: "
            f"{e.limit_away_from_average:.0e} away)", 18),
        Claim("V, after [29]", "the estimate is consistent with bounded error on the five plants",
            [needs(e.wac_lambda_max, at_most=1 + 1e-6)],
            f"largest lambda_max {e.wac_lambda_max:.3f} over all plants, graphs and L tried: never "
            "overconfident (Jensen), though with more variance than needed"),
        Claim("V, after [29]", "the error is bounded (no condition on the plant is named)",
            [needs(radius, at_most=1.0) for radius in e.radii],
            f"on unstable plants with blind nodes {diverging} of {len(e.radii)} networks diverge. "
            "Condition: |F| rho(Π^L D) < 1 for the mean, F² rho(Π^L D) < 1 for the covariance",
            test="any open choice"),
        Claim("VI", "almost identical to the centralised Kalman filter",
            [needs(ratio, at_most=_ALMOST) for ratio in (e.wac_rmse_least, e.wac_rmse_most)],
            "N, graph, Π, l and the sensors of the nodes are not printed. On the networks proposed "
            f"here RMSE is {e.wac_rmse_least:.2f} to {e.wac_rmse_most:.2f} times the centralised, "
            "and stays above it however many rounds there are", 22, "any open choice"),
        Claim("Figs. 10-14", "the estimate tracks the true output",
            [needs(ratio, at_most=1.0) for ratio in e.blind_rmse_to_measured.values()],
            "with matched noise, eight nodes on a ring: RMSE of a node without any sensor over "
            f"that of a measurement: {ratios}"),
        Claim("Fig. 12b", "the free state x1 of the aircraft is well covered",
            [needs(e.hidden_rmse_to_spread, at_most=0.25)],
            "with matched noise, at a node without sensor: RMSE over the state's own deviation "
            f"{e.hidden_rmse_to_spread:.2f}"),
    ]  # fmt: skip


# The errata that the project's study lists, by its numbers.
ERRATA = errata_from((
    ("(3)", "a trailing factor m/Ns", "it is the unit; the function is 1/(ms + b)"),
    ("after (7)", "states (x1, y1) and their derivatives; gamma is non-linear",
     "y2 = dy1/dt - (b2/M2) x1 + s y1 + (b2/M2) gamma; gamma enters linearly"),
    ("(10)", "psi_a2 = 1/(mu - G_l); - psi_a3 delta",
     "psi_a2 = 1/mu - G_l, for c2 = c7 needs mu sigma psi_a2 near 1; the sign of psi_a3 "
     "contradicts c3 = +.232: - G_w sin(gamma) theta + G_l delta"),
    ("(11)", "psi_q3 = eta G_w sin(gamma)",
     "it vanishes in level flight, and c6 = .0203 does not; G_t is defined and never used"),
    ("(14)", ".177", ".17742"),
    ("(18)", "T theta'' + b theta", "J theta'' + b theta'"),
    ("(21)", "-R/J; a state theta for theta'", "-R/L; theta'"),
    ("III, VI", "position poles -100 +- 100i, -200 with t_s = .01 s and this motor",
     "place exp(p t_s); for this motor -5 +- i, -15 ask for 195 V per rad instead of 458 kV"),
    ("VI", "nominal control 500 N",
     "the value that holds 10 m/s in open loop; N-bar r asks for 15 kN"),
    ("(22), (23), (25), (26), IV",
     "integral of e dy; C(s) with E(s) in it; (25) labelled V/R; V/U; the lag on the right",
     "integral of e dt; C(s) without E(s); (25) is the open loop without Kp; V/R; zero and "
     "pole of a lag are on the left"),
    ("(28)", "i = 0, ..., 2L + 1", "i = 0, ..., 2n; L is the number of iterations"),
    ("(alpha 3)-(alpha 8)", "one W", "W^(m) for means, W^(c) for covariances"),
    ("(alpha 4), (alpha 7)", "no Q, no R", "+ Q in (alpha 4), + R in (alpha 7)"),
    ("(alpha 5)", "propagated points used again",
     "draw them anew, or Q is not in the spread"),
    ("(alpha 8), (alpha 10), (beta 1)", "y^(i) - x; z = y - y^(i); W for gain and weights",
     "y^(i) - y predicted; z = y - y predicted; another letter for the gain"),
    ("2) of V", "x^i_n = x^i_{n,0}, P^i_{n,0} = P^i_{n,0}",
     "x^i_{n,0} = x^i_n, P^i_{n,0} = P^i_n"),
    ("(beta 3)-(beta 5)", "l = 0, ..., l; x_{n+l}; points of before",
     "L averages; x_{n,L}; draw the points anew from the fused pair, + Q"),
    ("after (31)", "Π = π^(1,j) R^n; v1 x^1 + v1 x^2 + ...",
     "Π = [π^ij], N x N, row-stochastic and primitive; sum of v_j x^j; v = 1/N if and only if "
     "doubly stochastic"),
    ("table of VI", "a row without a name; Q = p H'H, R = 1; Q = 10 I, R = .05",
     "it is the bus; the first are weights of the LQR, the second 3 m and 22 cm; "
     "noise='matched' has physical ones"),
    ("VI", "v of a unique distribution in (0, 1), and randn; P0 = 50 I solves the Riccati "
     "equation", "normal; it does not"),
    ("Figs. 11, 12, 14", "x3 = phi; (b) twice; speed", "y1; (a), (b); position"),
    ("VI", "(nothing)",
     "N, graph, Π, l and the sensors of the nodes: without them no distributed result of the "
     "paper can be repeated"),
    ("III, N-bar", "inv(A, B; C, D) gives N-bar, with the C of (21)",
     "with the two rows of C the matrix is not square: the controlled row alone; with the "
     "integrator of the bus there is no N-bar"),
))  # fmt: skip
