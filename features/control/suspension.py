"""Quarter-bus suspension: (4)-(9) of the weighted-average-consensus paper (Widjiantoro et al.).

The state of (9) is [x1, dx1/dt, y1, y2] with x1 the height of the body and y1 = x1 - x2 its
distance from the wheel. y2 is not dy1/dt, as the paper's text says, but
y2 = dy1/dt - (b2/M2) x1 + s y1 + (b2/M2) gamma, which removes the derivative of the road gamma.
"""

import numpy as np

from concord.features.control.continuous import ContinuousPlant, zero_order_hold
from concord.features.control.controllers import IntegralFeedback
from concord.features.control.networks import (
    Preset,
    choose,
    linear_plant,
    matched_noise,
    paper_noise,
)
from concord.features.control.references import Staircase, constant
from concord.features.control.transfer_functions import Rational, pid
from concord.plants.linear import Drift, LinearPlant, Signal

TIME_STEP_S = 0.0005
M1 = 2500.0  # kg, a quarter of the body
M2 = 320.0  # kg, wheel and axle
K1 = 80_000.0  # N/m, suspension
K2 = 500_000.0  # N/m, tyre
B1 = 350.0  # N s/m, suspension
B2 = 15_020.0  # N s/m, tyre
STIFFNESS_SUM = K1 / M1 + K1 / M2 + K2 / M2
DAMPING_SUM = B1 / M1 + B1 / M2 + B2 / M2

# The paper prints no gain. These are the University of Michigan's, found by trial and error there;
# the last is for the integral of y1.
GAIN = np.array([[0.0, 2.3e6, 5e8, 0.0]])
INTEGRAL_GAIN = np.array([[8e6]])
PID = pid(2 * 832_100.0, 2 * 624_075.0, 2 * 208_025.0)

ROAD_STEP: Staircase = constant(0.1)  # m, from the first step on


def dynamics() -> ContinuousPlant:
    """(9): control u in N between body and wheel, disturbance gamma, the road's height in m."""
    return ContinuousPlant(
        name="suspension",
        state_names=("body height", "body speed", "travel", "travel derivative form"),
        state_units=("m", "m/s", "m", "m/s"),
        state_matrix=np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [-B1 * B2 / (M1 * M2), 0.0, B1 / M1 * DAMPING_SUM - K1 / M1, -B1 / M1],
                [B2 / M2, 0.0, -DAMPING_SUM, 1.0],
                [K2 / M2, 0.0, -STIFFNESS_SUM, 0.0],
            ]
        ),
        control_matrix=np.array([[0.0], [1 / M1], [0.0], [1 / M1 + 1 / M2]]),
        output_row=np.array([[0.0, 0.0, 1.0, 0.0]]),
        disturbance_matrix=np.array([[0.0], [B1 * B2 / (M1 * M2)], [-B2 / M2], [-K2 / M2]]),
    )


def transfer_functions() -> tuple[Rational, Rational]:
    """(7): Y1/U with the road level, and Y1/Gamma without control."""
    det = (
        M1 * M2,
        M1 * (B1 + B2) + M2 * B1,
        M1 * (K1 + K2) + M2 * K1 + B1 * B2,
        B1 * K2 + B2 * K1,
        K1 * K2,
    )
    from_force = Rational((M1 + M2, B2, K2), det)
    from_road = Rational((-M1 * B2, -M1 * K2, 0.0, 0.0), det)
    return from_force, from_road


def suspension(
    nodes: int = 8,
    noise: Preset = "matched",
    road: Signal | None = None,
    *,
    road_known: bool = True,
) -> LinearPlant:
    """Return the network: y1 (2 mm), x1 (5 mm) and dx1/dt (.05 m/s) dealt to the seeing nodes.

    Matched process noise: a road of white height 1 cm and a white force of 200 N, each held over
    a step. `road`, in m, comes on top of it: known to the filters as the paper's second input, or
    to the truth alone. See networks.py for the presets and the blind nodes; raises ValueError for
    an unknown preset or no nodes.
    """
    continuous = dynamics()
    _, force = continuous.sampled(TIME_STEP_S)
    _, height = zero_order_hold(continuous.state_matrix, continuous.disturbance_matrix, TIME_STEP_S)
    matched = matched_noise(
        nodes,
        factor=np.hstack([200.0 * force, 0.01 * height]),
        outputs=np.eye(4)[[2, 0, 1]],
        noise_std=np.array([0.002, 0.005, 0.05]),
        prior_std=np.array([0.1, 0.1, 0.1, 0.1]),
    )
    paper = paper_noise(nodes, 10.0 * np.eye(4), continuous.output_row, variance=0.05)
    drift = None if road is None else Drift(height, road)
    return linear_plant(
        continuous,
        TIME_STEP_S,
        choose(noise, matched, paper),
        known_drift=drift if road_known else None,
        unknown_drift=None if road_known else drift,
    )


def suspension_controller() -> IntegralFeedback:
    """u = -K x - K_z (integral of y1), to hold y1 at 0; unlimited it takes 1.5 MN.

    No precompensation: with the integral in the state [A, B; C, 0] is singular.
    """
    row = dynamics().output_row
    return IntegralFeedback(GAIN, INTEGRAL_GAIN, row, TIME_STEP_S, constant(0.0))
