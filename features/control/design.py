"""Design of state feedback: gains, precompensation, and the refusal of what would not be stable.

python-control is imported by the functions that need it.
"""

from collections.abc import Sequence

import numpy as np

from concord.features.control.continuous import ContinuousPlant
from concord.features.control.controllers import StateFeedback
from concord.plants.linear import Signal


def controllability_rank(state_matrix: np.ndarray, control_matrix: np.ndarray) -> int:
    """Dimension of what the controls (n, p) can reach; n means controllable."""
    import control

    return int(np.linalg.matrix_rank(control.ctrb(state_matrix, control_matrix)))


def observability_rank(state_matrix: np.ndarray, rows: np.ndarray) -> int:
    """Dimension of what the outputs (m, n) can tell apart; n means observable."""
    import control

    return int(np.linalg.matrix_rank(control.obsv(state_matrix, rows)))


def pole_placement(
    state_matrix: np.ndarray, control_matrix: np.ndarray, poles: Sequence[complex]
) -> np.ndarray:
    """Return the gain K (1, n) that gives A - B K these eigenvalues (Ackermann, one control).

    For a sampled pair pass the poles of the z-plane. Raises ValueError for a number of poles
    that is not n, and (python-control) for a pair that is not controllable.
    """
    import control

    if len(poles) != len(state_matrix):
        raise ValueError(
            f"{len(poles)} poles for {len(state_matrix)} states: give one pole per state"
        )
    return np.atleast_2d(control.acker(state_matrix, control_matrix, list(poles)))


def lqr_gain(continuous: ContinuousPlant, output_weight: float) -> np.ndarray:
    """K (p, n) minimising the integral of output_weight * (C x)^2 + u'u (Q = p C'C, R = 1)."""
    import control

    cost = output_weight * continuous.output_row.T @ continuous.output_row
    effort = np.eye(continuous.control_matrix.shape[1])
    gain, _, _ = control.lqr(continuous.state_matrix, continuous.control_matrix, cost, effort)
    return np.asarray(gain)


def precompensation(
    transition_matrix: np.ndarray,
    control_matrix: np.ndarray,
    output_row: np.ndarray,
    gain: np.ndarray,
) -> np.ndarray:
    """N (p, r) with which u = N r - K x brings the sampled output C x to r without error.

    [F - I, G; C, 0] [N_x; N_u] = [0; I] and N = N_u + K N_x, with as many outputs as controls.
    Raises ValueError where that matrix is singular: the output cannot be held at r, as when the
    state already integrates that output.
    """
    n = len(transition_matrix)
    system = np.block(
        [
            [transition_matrix - np.eye(n), control_matrix],
            [output_row, np.zeros((len(output_row), control_matrix.shape[1]))],
        ]
    )
    # Columns are scaled alike before the rank is judged: a force in newton moves metres little.
    scale = np.linalg.norm(system, axis=0)
    if np.any(scale == 0) or np.linalg.matrix_rank(system / scale) < len(system):
        raise ValueError(
            f"precompensation: [F - I, G; C, 0] of size {len(system)} is singular, so no constant "
            "control holds the output at a reference; use reference 0 or drop the integrator"
        )
    wanted = np.concatenate([np.zeros((n, len(output_row))), np.eye(len(output_row))])
    solution = np.linalg.solve(system, wanted)
    return solution[n:] + gain @ solution[:n]


def refuse_unstable(
    name: str,
    transition_matrix: np.ndarray,
    control_matrix: np.ndarray,
    gain: np.ndarray,
    time_step_s: float,
) -> None:
    """Raises ValueError where F - G K has an eigenvalue on or outside the unit circle."""
    largest = np.abs(np.linalg.eigvals(transition_matrix - control_matrix @ gain)).max()
    if largest >= 1:
        raise ValueError(
            f"{name}: this gain is unstable when held over a time step of {time_step_s:g} s: "
            f"largest |z| = {largest:.2f}, and it must be below 1; place the sampled poles "
            "exp(p t) instead, or take a shorter time step"
        )


def continuous_gain_feedback(
    continuous: ContinuousPlant,
    time_step_s: float,
    gain: np.ndarray,
    signal: Signal,
    limit: float = np.inf,
) -> StateFeedback:
    """A gain K (p, n) designed in continuous time, run over held samples, with a sampled N.

    Raises ValueError where sampling makes it unstable (refuse_unstable), or as precompensation.
    """
    transition, control_matrix = continuous.sampled(time_step_s)
    refuse_unstable(continuous.name, transition, control_matrix, gain, time_step_s)
    forward = precompensation(transition, control_matrix, continuous.output_row, gain)
    return StateFeedback(gain, forward, signal, limit)


def placed_feedback(
    continuous: ContinuousPlant,
    time_step_s: float,
    poles: Sequence[complex],
    signal: Signal,
) -> StateFeedback:
    """State feedback that puts the sampled poles at exp(p t) for the poles p of the s-plane.

    Raises ValueError as pole_placement, continuous_gain_feedback (for poles not in the left half).
    """
    transition, control_matrix = continuous.sampled(time_step_s)
    sampled_poles = np.exp(np.asarray(poles) * time_step_s)
    gain = pole_placement(transition, control_matrix, list(sampled_poles))
    return continuous_gain_feedback(continuous, time_step_s, gain, signal)
