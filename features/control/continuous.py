"""A linear plant in continuous time, as a paper prints it, and its exact sampling.

The functions that need `scipy` import it, because code with sampled plants does not need it.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class ContinuousPlant:
    """dx/dt = A x + B u + D gamma; the controlled output is C x.

    state_matrix: A (n, n); control_matrix: B (n, p); output_row: C (1, n), what the reference is
    for; disturbance_matrix: D (n, r), of inputs that no controller commands.
    """

    name: str
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    state_matrix: np.ndarray
    control_matrix: np.ndarray
    output_row: np.ndarray
    disturbance_matrix: np.ndarray

    def sampled(self, time_step_s: float) -> tuple[np.ndarray, np.ndarray]:
        """F (n, n) and G (n, p) of this plant with its control held over each time step."""
        return zero_order_hold(self.state_matrix, self.control_matrix, time_step_s)


def zero_order_hold(
    state_matrix: np.ndarray, input_matrix: np.ndarray, time_step_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """F = exp(A t) and G = (integral of exp(A s) over the step) B, exact, for a held input.

    Both from one exponential of [[A, B], [0, 0]] t, which needs no inverse of A.
    Raises ValueError for a time step that is not positive.
    """
    from scipy.linalg import expm

    if not time_step_s > 0:
        raise ValueError(f"time step {time_step_s} s must be positive; pass seconds above 0")
    n, p = input_matrix.shape
    augmented = np.zeros((n + p, n + p))
    augmented[:n, :n] = state_matrix
    augmented[:n, n:] = input_matrix
    exponential = np.asarray(expm(augmented * time_step_s), dtype=np.float64)
    return exponential[:n, :n], exponential[:n, n:]


def van_loan(state_matrix: np.ndarray, noise_density: np.ndarray, time_step_s: float) -> np.ndarray:
    """Covariance (n, n) that white noise of a spectral density (n, n) adds in one time step.

    The integral of exp(A s) W exp(A s)' over the step; C. F. Van Loan, "Computing integrals
    involving the matrix exponential", IEEE Trans. Automatic Control 23(3), 1978.
    """
    from scipy.linalg import expm

    n = len(state_matrix)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = -state_matrix
    block[:n, n:] = noise_density
    block[n:, n:] = state_matrix.T
    exponential = np.asarray(expm(block * time_step_s), dtype=np.float64)
    cov = exponential[n:, n:].T @ exponential[:n, n:]
    return (cov + cov.T) / 2
