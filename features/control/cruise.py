"""Cruise control of a car: (1)-(3) of the weighted-average-consensus paper (Widjiantoro et al.)."""

import numpy as np

from concord.features.control.continuous import ContinuousPlant, van_loan
from concord.features.control.controllers import StateFeedback
from concord.features.control.design import placed_feedback
from concord.features.control.networks import (
    Preset,
    choose,
    linear_plant,
    matched_noise,
    paper_noise,
)
from concord.features.control.references import Staircase
from concord.features.control.transfer_functions import Rational, lag, proportional
from concord.plants.linear import LinearPlant

TIME_STEP_S = 0.01
MASS_KG = 1000.0
DAMPING_N_S_PER_M = 50.0
POLES = (-1.5,)

# Two sets of gains that follow the University of Michigan's tutorial; the paper prints none.
PROPORTIONAL = proportional(600.0)
LAG = lag(1300.0, zero=0.3, pole=0.03)

# 10 m/s for 30 s, then 7 m/s for 20 s (section III of the paper).
REFERENCE = Staircase(((10.0,), (7.0,)), (3000, 2000))


def dynamics() -> ContinuousPlant:
    """(2): m dv/dt = u - b v; state v in m/s, control u in N."""
    return ContinuousPlant(
        name="cruise",
        state_names=("speed",),
        state_units=("m/s",),
        state_matrix=np.array([[-DAMPING_N_S_PER_M / MASS_KG]]),
        control_matrix=np.array([[1 / MASS_KG]]),
        output_row=np.array([[1.0]]),
        disturbance_matrix=np.zeros((1, 0)),
    )


def transfer_function() -> Rational:
    """(3): V/U = 1 / (m s + b); the trailing "m/Ns" in print is its unit."""
    return Rational((1.0,), (MASS_KG, DAMPING_N_S_PER_M))


def cruise(nodes: int = 8, noise: Preset = "matched") -> LinearPlant:
    """Return the network: seeing node i measures the speed with variance .5 (1 + i) (m/s)².

    Matched process noise: white acceleration of density .1 (m/s)²/s. See networks.py for the
    presets and the blind nodes; raises ValueError for an unknown preset or no nodes.
    """
    continuous = dynamics()
    cov = van_loan(continuous.state_matrix, np.array([[0.1]]), TIME_STEP_S)
    matched = matched_noise(
        nodes,
        factor=np.sqrt(cov),
        outputs=np.eye(1),
        noise_std=np.sqrt(np.array([0.5])),
        prior_std=np.sqrt(np.array([50.0])),
    )
    paper = paper_noise(nodes, np.array([[0.1]]), continuous.output_row, variance=0.5)
    return linear_plant(continuous, TIME_STEP_S, choose(noise, matched, paper))


def cruise_controller() -> StateFeedback:
    """Return the paper's pole -1.5, placed at exp(-1.5 t), following REFERENCE.

    Unlimited it starts with 15 kN. The paper's "nominal" 500 N is the open-loop value for 10 m/s;
    as a limit it leaves the car at 7.8 m/s after 30 s.
    """
    return placed_feedback(dynamics(), TIME_STEP_S, POLES, REFERENCE)
