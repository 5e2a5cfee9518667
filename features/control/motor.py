"""DC motor, speed and position: (16)-(21) of the weighted-average-consensus paper.

Widjiantoro et al.; states [speed, current] and [position, speed, current]. (18) prints T for the
inertia J and b theta for b dtheta/dt; (21) prints -R/J for -R/L.
"""

import numpy as np

from concord.features.control.continuous import ContinuousPlant
from concord.features.control.controllers import StateFeedback
from concord.features.control.design import placed_feedback
from concord.features.control.networks import (
    NoisePreset,
    Preset,
    choose,
    linear_plant,
    matched_noise,
    paper_noise,
)
from concord.features.control.references import square
from concord.features.control.transfer_functions import (
    Rational,
    lag,
    pid,
    proportional,
    proportional_integral,
)
from concord.plants.linear import LinearPlant

TIME_STEP_S = 0.01
INERTIA_KG_M2 = 0.01
FRICTION_N_M_S = 0.1
TORQUE_CONSTANT = 0.01  # N m/A, and V s/rad
RESISTANCE_OHM = 1.0
INDUCTANCE_H = 0.5

SPEED_POLES = (-5 + 1j, -5 - 1j)
# The paper's position poles belong to another, faster motor: they ask this one for 458 kV per rad
# even when placed as sampled poles. The product's default is slower.
PAPER_POSITION_POLES = (-100 + 100j, -100 - 100j, -200)
POSITION_POLES = (-5 + 1j, -5 - 1j, -15)

# The speed gains follow the University of Michigan's tutorial. The paper prints none, and the
# tutorial's position motor is another one: the position gains are this project's.
SPEED_PID = pid(100.0, 200.0, 10.0)
SPEED_LAG = lag(70.0, zero=1.0, pole=0.01)
POSITION_PROPORTIONAL = proportional(5.0)
POSITION_PROPORTIONAL_INTEGRAL = proportional_integral(10.0, 1.0)
POSITION_PID = pid(60.0, 40.0, 20.0)

# The paper shows two references without numbers.
REFERENCE = square(1.0, -0.5, hold_steps=150)


def position_dynamics() -> ContinuousPlant:
    """(21): control V in volt; the controlled output is the first row of the C printed there."""
    return ContinuousPlant(
        name="dc-motor-position",
        state_names=("position", "speed", "current"),
        state_units=("rad", "rad/s", "A"),
        state_matrix=np.array(
            [
                [0.0, 1.0, 0.0],
                [0.0, -FRICTION_N_M_S / INERTIA_KG_M2, TORQUE_CONSTANT / INERTIA_KG_M2],
                [0.0, -TORQUE_CONSTANT / INDUCTANCE_H, -RESISTANCE_OHM / INDUCTANCE_H],
            ]
        ),
        control_matrix=np.array([[0.0], [0.0], [1 / INDUCTANCE_H]]),
        output_row=np.array([[1.0, 0.0, 0.0]]),
        disturbance_matrix=np.zeros((3, 0)),
    )


def speed_dynamics() -> ContinuousPlant:
    """(21) without the position."""
    whole = position_dynamics()
    return ContinuousPlant(
        name="dc-motor-speed",
        state_names=whole.state_names[1:],
        state_units=whole.state_units[1:],
        state_matrix=whole.state_matrix[1:, 1:],
        control_matrix=whole.control_matrix[1:],
        output_row=np.array([[1.0, 0.0]]),
        disturbance_matrix=np.zeros((2, 0)),
    )


def speed_transfer_function() -> Rational:
    """(20): speed over voltage."""
    mechanical = (INERTIA_KG_M2, FRICTION_N_M_S)
    electrical = (INDUCTANCE_H, RESISTANCE_OHM)
    denominator = np.polyadd(np.polymul(mechanical, electrical), [TORQUE_CONSTANT**2])
    return Rational((TORQUE_CONSTANT,), tuple(denominator))


def position_transfer_function() -> Rational:
    """(20) over s: position over voltage."""
    speed = speed_transfer_function()
    return Rational(speed.numerator, (*speed.denominator, 0.0))


def motor_speed(nodes: int = 8, noise: Preset = "matched") -> LinearPlant:
    """Return the network: speed (.05 rad/s) and current (.05 A) dealt to the seeing nodes.

    Matched process noise: .5 V, held over a step, and a torque that moves the speed by .02 rad/s
    per step. See networks.py for the presets and the blind nodes; raises ValueError for an unknown
    preset or no nodes.
    """
    continuous = speed_dynamics()
    _, voltage = continuous.sampled(TIME_STEP_S)
    matched = matched_noise(
        nodes,
        factor=np.hstack([0.5 * voltage, [[0.02], [0.0]]]),
        outputs=np.eye(2),
        noise_std=np.array([0.05, 0.05]),
        prior_std=np.sqrt([0.1, 0.1]),
    )
    return _motor(continuous, nodes, noise, matched)


def motor_position(nodes: int = 8, noise: Preset = "matched") -> LinearPlant:
    """Return the network: position (.01 rad), speed (.05 rad/s) and current (.05 A) dealt likewise.

    Matched process noise: .5 V, held over a step, a torque that moves the speed by .02 rad/s per
    step, and 1e-10 I. With motor_position_controller this is the scenario MOTOR. See networks.py
    for the presets and the blind nodes; raises ValueError for an unknown preset or no nodes.
    """
    continuous = position_dynamics()
    _, voltage = continuous.sampled(TIME_STEP_S)
    matched = matched_noise(
        nodes,
        factor=np.hstack([0.5 * voltage, [[0.0], [0.02], [0.0]], 1e-5 * np.eye(3)]),
        outputs=np.eye(3),
        noise_std=np.array([0.01, 0.05, 0.05]),
        prior_std=np.sqrt([0.1, 0.1, 0.1]),
    )
    return _motor(continuous, nodes, noise, matched)


def _motor(
    continuous: ContinuousPlant, nodes: int, noise: Preset, matched: NoisePreset
) -> LinearPlant:
    row = continuous.output_row
    paper = paper_noise(nodes, 50.0 * row.T @ row, row, variance=1.0)
    return linear_plant(continuous, TIME_STEP_S, choose(noise, matched, paper))


def motor_speed_controller() -> StateFeedback:
    """Return the paper's poles -5 +- i, placed at exp(p t), following REFERENCE in rad/s."""
    return placed_feedback(speed_dynamics(), TIME_STEP_S, SPEED_POLES, REFERENCE)


def motor_position_controller() -> StateFeedback:
    """Poles -5 +- i and -15, placed at exp(p t), following REFERENCE in rad."""
    return placed_feedback(position_dynamics(), TIME_STEP_S, POSITION_POLES, REFERENCE)
