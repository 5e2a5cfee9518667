"""The claims of the consensus paper, each beside what was measured."""

from concord.papers.kit.claims import Claim, ClaimFinding, needs
from concord.papers.wac.evidence import WacEvidence

# Relative differences and weights that are equal but for rounding.
_ROUNDING = 1e-9
# The band in which a step response counts as settled, of the nominal speed.
_SETTLED = 0.02
# An estimate that is "almost identical" to another, as a ratio of RMSE.
_ALMOST = 1.05
# Least gain of a filter that corrects a state at all.
_CORRECTED = 0.01


def judge(evidence: WacEvidence) -> list[Claim]:
    """All claims that can be measured, in the order of the paper."""
    return [
        *_plant_claims(evidence),
        *_feedback_claims(evidence),
        *_classical_claims(evidence),
        *_filter_claims(evidence),
        *_consensus_claims(evidence),
        *_result_claims(evidence),
    ]


def _equal(figure: float, expected: float, tolerance: float) -> ClaimFinding:
    return needs(figure, at_least=expected - tolerance, at_most=expected + tolerance)


def _plant_claims(e: WacEvidence) -> list[Claim]:
    row = ", ".join(f"{entry:.4g}" for entry in e.bus_travel_row)
    return [
        Claim(
            "(7), (9)",
            "the state space (9) has the transfer functions (7)",
            [needs(e.bus_realisation_error, at_most=_ROUNDING)],
            f"largest relative difference {e.bus_realisation_error:.1g}",
        ),
        Claim(
            "after (7)",
            "the states are x1, y1 and their derivatives",
            [needs(e.bus_travel_away, at_most=_ROUNDING)],
            f"dy1/dt = [{row}] x + ..., not [0, 0, 0, 1] x. Correct: y2 = dy1/dt - (b2/M2) x1 + "
            "s y1 + (b2/M2) gamma with s = b1/M1 + b1/M2 + b2/M2",
            2,
        ),
        Claim(
            "(21)",
            "the last entry of the motor's matrix is -R/J",
            [_equal(e.speed_gain_ratio, 1.0, 0.01)],
            f"then 1 V gives {e.speed_gain_printed:.4f} rad/s, and (20) {e.speed_gain:.4f}. "
            "Correct: -R/L",
            7,
            "print against print",
        ),
        Claim(
            "III",
            "controllability and observability matrices have full rank",
            [needs(e.full_ranks, at_least=e.plants)],
            f"{e.full_ranks} of {e.plants} plants from the controlled output",
        ),
    ]  # fmt: skip


def _feedback_claims(e: WacEvidence) -> list[Claim]:
    loops = e.loops
    degrees = [57.29578 * angle for angle in loops.pitch_deflections_rad]
    return [
        Claim(
            "Fig. 10, III",
            "with the pole -1.5 the car follows 10 m/s for 30 s and 7 m/s for 20 s",
            [
                needs(loops.cruise_first.settling_time_s, at_most=30),
                needs(loops.cruise_second.settling_time_s, at_most=20),
            ],
            f"settled (2 %) after {loops.cruise_first.settling_time_s:.2f} s and "
            f"{loops.cruise_second.settling_time_s:.2f} s, starting with "
            f"{loops.cruise_start_n / 1e3:.0f} kN",
        ),
        Claim(
            "VI",
            "the nominal control is 500 N",
            [_equal(loops.cruise_limited_speed, 10.0, 10.0 * _SETTLED)],
            f"limited to 500 N the car has {loops.cruise_limited_speed:.2f} m/s after 30 s. "
            "Correct: 500 N hold 10 m/s at rest; N-bar r = 15 kN at the start",
            9,
        ),
        Claim(
            "Fig. 11, III",
            "the suspension's control brings y1 to rest in less than 5 s",
            [
                needs(loops.bus_settling_s, at_most=5.0),
                needs(loops.bus_open_beyond_5_mm_s, at_most=5.0),
            ],
            "no gain is printed, so it may be any. With the University of Michigan's, y1 stays "
            f"below 2 % of its peak after {loops.bus_settling_s:.2f} s, with "
            f"{loops.bus_force_n / 1e6:.1f} MN; with none it is beyond 5 mm until "
            f"{loops.bus_open_beyond_5_mm_s:.1f} s",
            test="any open choice",
        ),
        Claim(
            "Fig. 12, VI",
            "the pitch follows .2 and .5 within 7 s",
            [needs(step.settling_time_s, at_most=7.0) for step in loops.pitch_steps],
            f"with p = 50 settled after {loops.pitch_steps[0].settling_time_s:.2f} s, overshoot "
            f"{loops.pitch_steps[0].overshoot_percent:.1f} %; the elevator would have to turn by "
            f"{degrees[0]:.0f} and {degrees[1]:.0f} degrees",
        ),
        Claim(
            "Fig. 13, III",
            "the motor's speed follows with poles -5 +- i",
            [
                needs(loops.speed_step.settling_time_s, at_most=1.5),
                needs(loops.speed_step.overshoot_percent, at_most=1.0),
            ],
            f"settled after {loops.speed_step.settling_time_s:.2f} s, overshoot "
            f"{loops.speed_step.overshoot_percent:.1f} %",
        ),
        Claim(
            "Fig. 14, III",
            "the motor's position follows with poles -100 +- 100i, -200 at t_s = .01 s",
            [needs(loops.position_largest_pole, at_most=1.0)],
            f"unstable: largest |z| = {loops.position_largest_pole:.2f}. Correct: place "
            f"exp(p t_s); that settles in {loops.position_fast.settling_time_s:.2f} s with "
            f"{loops.position_fast_volt / 1e3:.0f} kV per rad. These poles belong to another motor",
            8,
        ),
    ]


def _classical_claims(e: WacEvidence) -> list[Claim]:
    return [
        Claim(
            "Fig. 7",
            "P, PI, PID, lag, lead and notch controllers stabilise the plants",
            [needs(pole, at_most=0.0) for pole in e.rightmost_poles.values()],
            "no compensator is printed; tried with the tutorial's and this project's, of which "
            f"{sum(pole < 0 for pole in e.rightmost_poles.values())} of {len(e.rightmost_poles)} "
            "are stable at their own gain",
            test="any open choice",
        ),
        Claim(
            "(26)",
            "closed with a lag compensator, the car has m s² + (b + m p0 + Kp) s + b p0 + Kp z0",
            [needs(e.lag_loop_error, at_most=_ROUNDING)],
            f"coefficients equal to {e.lag_loop_error:.1g}; the label V/U is V/R (erratum 10)",
        ),
    ]


def _filter_claims(e: WacEvidence) -> list[Claim]:
    gains = "; ".join(
        # Adding zero rids a rounded -0 of its sign.
        f"{plant} " + ", ".join(f"{round(gain, 3) + 0.0:.3f}" for gain in entries)
        for plant, entries in e.printed_noise_gains.items()
    )
    hidden = (*e.printed_noise_gains["pitch"][:2], *e.printed_noise_gains["position"][1:])
    return [
        Claim(
            "table of VI",
            "Q = p H'H and R = 1 touch the hidden states",
            [needs(max(map(abs, hidden)), at_least=_CORRECTED)],
            f"gains {gains}: the measured state is nearly replaced, hidden ones are not corrected. "
            "They are the weights of the LQR. Correct: Q of the physical noise (noise='matched')",
            19,
        ),
        Claim(
            "VI",
            "P0 = 50 I solves the algebraic Riccati equation",
            [needs(e.prior_away_from_riccati, at_most=0.01)],
            f"for the motor's speed it is {100 * e.prior_away_from_riccati:.0f} % away from the "
            "solution",
            20,
        ),
        Claim(
            "Fig. 10b",
            "the error converges to zero",
            [needs(e.rest_error_m_s, at_most=1e-3)],
            f"with the Q and R printed it keeps a standard deviation of {e.rest_error_m_s:.2f} m/s "
            "at a node alone, on a truth without process noise",
        ),
    ]


def _consensus_claims(e: WacEvidence) -> list[Claim]:
    diverging = sum(radius > 1 for radius in e.radii)
    return [
        Claim(
            "after (30)",
            "in the limit all nodes enter with the weight v1",
            [needs(e.limit_away_from_first_weight, at_most=_ROUNDING)],
            "equal-neighbour weights on a path: the limit's weights differ by up to "
            f"{e.limit_away_from_first_weight:.3f}. Correct: sum of v_j x_j; v = 1/N only for "
            "doubly stochastic weights (Metropolis: "
            f"{e.limit_away_from_average:.0e} away)",
            18,
        ),
        Claim(
            "V, after [29]",
            "the estimate is consistent with bounded error on the five plants",
            [needs(e.wac_lambda_max, at_most=1 + 1e-6)],
            f"largest lambda_max {e.wac_lambda_max:.3f} over all plants, graphs and L tried: never "
            "overconfident (Jensen), though with more variance than needed",
        ),
        Claim(
            "V, after [29]",
            "the error is bounded (no condition on the plant is named)",
            [needs(radius, at_most=1.0) for radius in e.radii],
            f"on unstable plants with blind nodes {diverging} of {len(e.radii)} networks diverge. "
            "Condition: |F| rho(Π^L D) < 1 for the mean, F² rho(Π^L D) < 1 for the covariance",
            test="any open choice",
        ),
    ]


def _result_claims(e: WacEvidence) -> list[Claim]:
    ratios = ", ".join(f"{plant} {ratio:.2f}" for plant, ratio in e.blind_rmse_to_measured.items())
    return [
        Claim(
            "VI",
            "almost identical to the centralised Kalman filter",
            [needs(ratio, at_most=_ALMOST) for ratio in (e.wac_rmse_least, e.wac_rmse_most)],
            "N, graph, Π, l and the sensors of the nodes are not printed. On the networks proposed "
            f"here RMSE is {e.wac_rmse_least:.2f} to {e.wac_rmse_most:.2f} times the centralised, "
            "and stays above it however many rounds there are",
            22,
            "any open choice",
        ),
        Claim(
            "Figs. 10-14",
            "the estimate tracks the true output",
            [needs(ratio, at_most=1.0) for ratio in e.blind_rmse_to_measured.values()],
            "with matched noise, eight nodes on a ring: RMSE of a node without any sensor over "
            f"that of a measurement: {ratios}",
        ),
        Claim(
            "Fig. 12b",
            "the free state x1 of the aircraft is well covered",
            [needs(e.hidden_rmse_to_spread, at_most=0.25)],
            "with matched noise, at a node without sensor: RMSE over the state's own deviation "
            f"{e.hidden_rmse_to_spread:.2f}",
        ),
    ]
