"""The claims of the consensus paper, each beside what was measured: `judge` reads the verdict off
the numbers, so that another number gives another verdict."""

from experiments.reproduce_report import Claim, Verdict
from experiments.reproduce_wac_evidence import Evidence

UNPRINTED: Verdict = "not reproducible as printed"


def judge(evidence: Evidence) -> list[Claim]:
    """All claims that can be measured."""
    return [
        *_plant_claims(evidence),
        *_feedback_claims(evidence),
        *_classical_claims(evidence),
        *_filter_claims(evidence),
        *_consensus_claims(evidence),
        *_result_claims(evidence),
    ]


def _held(holds: bool, otherwise: Verdict = "wrong") -> Verdict:
    return "reproduced" if holds else otherwise


def _plant_claims(e: Evidence) -> list[Claim]:
    row = ", ".join(f"{entry:.4g}" for entry in e.bus_travel_row)
    return [
        Claim(
            "(7), (9)",
            "the state space (9) has the transfer functions (7)",
            _held(e.bus_realisation_error < 1e-9),
            f"largest relative difference {e.bus_realisation_error:.1g}",
        ),
        Claim(
            "after (7)",
            "the states are x1, y1 and their derivatives",
            _held(e.bus_travel_row == (0.0, 0.0, 0.0, 1.0)),
            f"dy1/dt = [{row}] x + ..., not [0, 0, 0, 1] x. Correct: y2 = dy1/dt - (b2/M2) x1 + "
            "s y1 + (b2/M2) gamma with s = b1/M1 + b1/M2 + b2/M2",
            2,
        ),
        Claim(
            "(14)",
            "the numerator of the pitch is 1.151 s + .177",
            _held(abs(e.pitch_numerator - 0.177) < 5e-4),
            f"{e.pitch_numerator:.5f}: .177 is rounded (erratum 5)",
        ),
        Claim(
            "(21)",
            "the last entry of the motor's matrix is -R/J",
            _held(abs(e.speed_gain_printed / 0.0999 - 1) < 1e-2),
            f"then 1 V gives {e.speed_gain_printed:.4f} rad/s, and (20) {e.speed_gain:.4f}. "
            "Correct: -R/L",
            7,
        ),
        Claim(
            "III",
            "controllability and observability matrices have full rank",
            _held(e.full_ranks),
            "all five plants from the controlled output"
            if e.full_ranks
            else "not all five plants from the controlled output",
        ),
    ]


def _feedback_claims(e: Evidence) -> list[Claim]:
    loops = e.loops
    rows, columns = e.compensation_shape
    degrees = [57.29578 * angle for angle in loops.pitch_deflections_rad]
    return [
        Claim(
            "Fig. 10, III",
            "with the pole -1.5 the car follows 10 m/s for 30 s and 7 m/s for 20 s",
            _held(
                loops.cruise_first.settling_time_s < 30 and loops.cruise_second.settling_time_s < 20
            ),
            f"settled (2 %) after {loops.cruise_first.settling_time_s:.2f} s and "
            f"{loops.cruise_second.settling_time_s:.2f} s, starting with "
            f"{loops.cruise_start_n / 1e3:.0f} kN",
        ),
        Claim(
            "VI",
            "the nominal control is 500 N",
            _held(abs(loops.cruise_limited_speed - 10) < 0.2),
            f"limited to 500 N the car has {loops.cruise_limited_speed:.2f} m/s after 30 s. "
            "Correct: 500 N hold 10 m/s at rest; N-bar r = 15 kN at the start",
            9,
        ),
        Claim(
            "Fig. 11, III",
            "the suspension's control brings y1 to rest in less than 5 s",
            UNPRINTED if loops.bus_settling_s < 5 else "wrong",
            "no gain is printed. With the University of Michigan's, y1 stays below 2 % of its peak "
            f"after {loops.bus_settling_s:.2f} s, with {loops.bus_force_n / 1e6:.1f} MN",
        ),
        Claim(
            "III, N-bar",
            "inv(A, B; C, D) gives N-bar, with the C of (21)",
            _held(rows == columns),
            f"with two rows of C the matrix is {rows} x {columns}. Correct: the controlled row "
            "alone; with the integrator of the bus there is no N-bar",
        ),
        Claim(
            "Fig. 12, VI",
            "the pitch follows .2 and .5 within 7 s",
            _held(all(step.settling_time_s < 7 for step in loops.pitch_steps)),
            f"with p = 50 settled after {loops.pitch_steps[0].settling_time_s:.2f} s, overshoot "
            f"{loops.pitch_steps[0].overshoot_percent:.1f} %; the elevator would have to turn by "
            f"{degrees[0]:.0f} and {degrees[1]:.0f} degrees",
        ),
        Claim(
            "Fig. 13, III",
            "the motor's speed follows with poles -5 +- i",
            _held(
                loops.speed_step.settling_time_s < 1.5 and loops.speed_step.overshoot_percent < 1
            ),
            f"settled after {loops.speed_step.settling_time_s:.2f} s, overshoot "
            f"{loops.speed_step.overshoot_percent:.1f} %",
        ),
        Claim(
            "Fig. 14, III",
            "the motor's position follows with poles -100 +- 100i, -200 at t_s = .01 s",
            _held(loops.position_largest_pole < 1),
            f"unstable: largest |z| = {loops.position_largest_pole:.2f}. Correct: place "
            f"exp(p t_s); that settles in {loops.position_fast.settling_time_s:.2f} s with "
            f"{loops.position_fast_volt / 1e3:.0f} kV per rad. These poles belong to another motor",
            8,
        ),
    ]


def _classical_claims(e: Evidence) -> list[Claim]:
    return [
        Claim(
            "Fig. 7",
            "root loci of P, PI, PID, lag, lead and notch controllers",
            UNPRINTED if e.stable_designs == e.designs else "wrong",
            "no compensator is printed; drawn with the tutorial's and this project's, of which "
            f"{e.stable_designs} of {e.designs} are stable at their own gain",
        ),
        Claim(
            "(26)",
            "closed with a lag compensator, the car has m s² + (b + m p0 + Kp) s + b p0 + Kp z0",
            _held(e.lag_loop_error < 1e-9),
            f"coefficients equal to {e.lag_loop_error:.1g}; the label V/U is V/R (erratum 10)",
        ),
        Claim(
            "IV",
            "the lag considers the right of the s-plane",
            _held(e.lag_zero > 0 or e.lag_pole > 0),
            f"its zero is {e.lag_zero:g} and its pole {e.lag_pole:g}: both on the left",
            10,
        ),
    ]


def _filter_claims(e: Evidence) -> list[Claim]:
    gains = "; ".join(
        # Adding zero rids a rounded -0 of its sign.
        f"{plant} " + ", ".join(f"{round(gain, 3) + 0.0:.3f}" for gain in entries)
        for plant, entries in e.printed_noise_gains.items()
    )
    hidden = (e.printed_noise_gains["pitch"][:2], e.printed_noise_gains["position"][1:])
    corrected = all(abs(gain) > 0.01 for entries in hidden for gain in entries)
    step, reading = e.bus_noise_m
    return [
        Claim(
            "(28)",
            "sigma points i = 0, ..., 2L + 1",
            _held(e.sigma_points_of_three_states == 2 * 3 + 2),
            f"three states have {e.sigma_points_of_three_states}. Correct: i = 0, ..., 2n, and L "
            "is the number of iterations",
            11,
        ),
        Claim(
            "(alpha 4), (alpha 7)",
            "predicted and innovation covariances are those of the points alone",
            _held(e.second_innovation_variance_as_printed > 0),
            "without Q and R the cruise filter has S = "
            f"{e.second_innovation_variance_as_printed:g} in its second step and cannot go on. "
            "Correct: + Q in (alpha 4), + R in (alpha 7)",
            13,
        ),
        Claim(
            "table of VI",
            "Q = p H'H and R = 1 touch the hidden states",
            _held(corrected),
            f"gains {gains}: the measured state is nearly replaced, hidden ones are not corrected. "
            "They are the weights of the LQR. Correct: Q of the physical noise (noise='matched')",
            19,
        ),
        Claim(
            "table of VI",
            "Q = 10 I, R = .05 describe the bus",
            _held(step < 0.1 and reading < 0.1),
            f"{step:.1f} m per step of half a millisecond, and readings of {100 * reading:.0f} cm, "
            "for a travel of millimetres",
            19,
        ),
        Claim(
            "VI",
            "P0 = 50 I solves the algebraic Riccati equation",
            _held(e.prior_away_from_riccati < 0.01),
            f"for the motor's speed it is {100 * e.prior_away_from_riccati:.0f} % away from the "
            "solution",
            20,
        ),
        Claim(
            "Fig. 10b",
            "the error converges to zero",
            _held(e.rest_error_m_s < 1e-3),
            f"with the Q and R printed it keeps a standard deviation of {e.rest_error_m_s:.2f} m/s "
            "at a node alone, on a truth without process noise",
        ),
    ]


def _consensus_claims(e: Evidence) -> list[Claim]:
    return [
        Claim(
            "after (30)",
            "in the limit all nodes enter with the weight v1",
            _held(e.limit_away_from_first_weight < 1e-9),
            "equal-neighbour weights on a path: the limit's weights differ by up to "
            f"{e.limit_away_from_first_weight:.3f}. Correct: sum of v_j x_j; v = 1/N only for "
            "doubly stochastic weights (Metropolis: "
            f"{e.limit_away_from_average:.0e} away)",
            18,
        ),
        Claim(
            "(beta 3), (beta 4)",
            "l = 0, ..., l are l averages",
            _held(e.averages_of_three_rounds == 3),
            f"l = 3 makes {e.averages_of_three_rounds}. Correct: L is the number of averages",
            17,
        ),
        Claim(
            "V, after [29]",
            "the estimate is consistent with bounded error on the five plants",
            _held(e.wac_lambda_max <= 1 + 1e-6),
            f"largest lambda_max {e.wac_lambda_max:.3f} over all plants, graphs and L tried: never "
            "overconfident (Jensen), though with more variance than needed",
        ),
        Claim(
            "V, after [29]",
            "the error is bounded (no condition on the plant is named)",
            _held(e.diverging == 0, UNPRINTED),
            f"on unstable plants with blind nodes {e.diverging} of {e.unstable_networks} networks "
            "diverge. Condition: |F| rho(Π^L D) < 1 for the mean, F² rho(Π^L D) < 1 for the "
            "covariance",
        ),
    ]


def _result_claims(e: Evidence) -> list[Claim]:
    ratios = ", ".join(f"{plant} {ratio:.2f}" for plant, ratio in e.blind_rmse_to_measured.items())
    near = e.wac_rmse_most < 1.05
    return [
        Claim(
            "VI",
            "almost identical to the centralised Kalman filter",
            _held(near, UNPRINTED),
            "N, graph, Π, l and the sensors of the nodes are not printed. On the networks proposed "
            f"here RMSE is {e.wac_rmse_least:.2f} to {e.wac_rmse_most:.2f} times the centralised, "
            "and stays above it however many rounds there are",
            None if near else 22,
        ),
        Claim(
            "Figs. 10-14",
            "the estimate tracks the true output",
            _held(max(e.blind_rmse_to_measured.values()) < 1, UNPRINTED),
            "with matched noise, eight nodes on a ring: RMSE of a node without any sensor over "
            f"that of a measurement: {ratios}",
        ),
        Claim(
            "Fig. 12b",
            "the free state x1 of the aircraft is well covered",
            _held(e.hidden_rmse_to_spread < 0.25, UNPRINTED),
            "with matched noise, at a node without sensor: RMSE over the state's own deviation "
            f"{e.hidden_rmse_to_spread:.2f}",
        ),
    ]
