"""Longitudinal pitch of an aircraft: (10)-(15) of the weighted-average-consensus paper.

Widjiantoro et al.; state [alpha, q, theta]. q is not in rad/s: d(theta)/dt = 56.7 q.
"""

import numpy as np

from concord.features.control.continuous import ContinuousPlant
from concord.features.control.controllers import StateFeedback
from concord.features.control.design import continuous_gain_feedback, lqr_gain
from concord.features.control.networks import (
    Preset,
    choose,
    linear_plant,
    matched_noise,
    paper_noise,
)
from concord.features.control.references import Staircase
from concord.features.control.transfer_functions import Rational, lead
from concord.plants.linear import LinearPlant

TIME_STEP_S = 0.01
C1, C2, C3, C4, C5, C6, C7 = -0.313, 56.7, 0.232, -0.0139, -0.426, 0.0203, 56.7
OUTPUT_WEIGHT = 50.0

# After the University of Michigan's tutorial; the paper prints no gains.
LEAD = lead(200.0, zero=0.9, pole=20.0)

# The paper's two references, "within 7 seconds" each.
REFERENCE = Staircase(((0.2,), (0.5,)), (700, 700))


def dynamics() -> ContinuousPlant:
    """(15): control delta, the elevator's angle, in rad."""
    return ContinuousPlant(
        name="pitch",
        state_names=("angle of attack", "pitch rate", "pitch angle"),
        state_units=("rad", "rad/s / 56.7", "rad"),
        state_matrix=np.array([[C1, C2, 0.0], [C4, C5, 0.0], [0.0, C7, 0.0]]),
        control_matrix=np.array([[C3], [C6], [0.0]]),
        output_row=np.array([[0.0, 0.0, 1.0]]),
        disturbance_matrix=np.zeros((3, 0)),
    )


def transfer_function() -> Rational:
    """Theta/Delta from (13); (14) prints its numerator rounded, 1.151 s + .177."""
    numerator = (C7 * C6, C7 * (C4 * C3 - C1 * C6))
    return Rational(numerator, (1.0, -(C1 + C5), C1 * C5 - C2 * C4, 0.0))


def pitch(nodes: int = 8, noise: Preset = "matched") -> LinearPlant:
    """The network: theta (.01 rad), q (1.8e-4) and alpha (.02 rad) dealt to the seeing nodes.

    Matched process noise: the elevator trembles by .05 rad, held over a step, and gusts move alpha
    by .002 and q by 2e-5 per step. See networks.py for the presets and the blind nodes; raises
    ValueError for an unknown preset or no nodes.
    """
    continuous = dynamics()
    _, elevator = continuous.sampled(TIME_STEP_S)
    matched = matched_noise(
        nodes,
        factor=np.hstack([0.05 * elevator, np.eye(3)[:, :2] * [0.002, 2e-5]]),
        outputs=np.eye(3)[[2, 1, 0]],
        noise_std=np.array([0.01, 1.8e-4, 0.02]),
        prior_std=np.array([0.05, 5e-4, 0.05]),
    )
    row = continuous.output_row
    paper = paper_noise(nodes, OUTPUT_WEIGHT * row.T @ row, row, variance=1.0)
    return linear_plant(continuous, TIME_STEP_S, choose(noise, matched, paper))


def pitch_controller() -> StateFeedback:
    """The paper's LQR with p = 50. Unlimited it deflects the elevator by 7 times the reference."""
    continuous = dynamics()
    gain = lqr_gain(continuous, OUTPUT_WEIGHT)
    return continuous_gain_feedback(continuous, TIME_STEP_S, gain, REFERENCE)
