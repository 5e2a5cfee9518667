"""Continuous linear models at a sampling time, exactly; needs scipy, and only when called."""

import numpy as np


def discretise(A: np.ndarray, B: np.ndarray, time_step_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Zero-order-hold equivalent (F, G) of dx/dt = A x + B u with u constant over each step.

    Source: Van Loan (1978), Computing integrals involving the matrix exponential; the exponential
    of [[A, B], [0, 0]] holds both.

    Args:
        A: (n, n), per second.
        B: (n, p).
        time_step_s: the sampling time.

    Returns:
        F (n, n) and G (n, p) of x[k + 1] = F x[k] + G u[k].

    Raises:
        ValueError: time_step_s <= 0, or A and B do not fit.
    """
    n = _check(A, time_step_s)
    if B.ndim != 2 or B.shape[0] != n:
        raise ValueError(f"B has shape {B.shape}, but A is ({n}, {n}): give B {n} rows")
    p = B.shape[1]
    exponential = _expm(np.block([[A, B], [np.zeros((p, n + p))]]) * time_step_s)
    return exponential[:n, :n], exponential[:n, n:]


def discretise_noise(A: np.ndarray, noise_density: np.ndarray, time_step_s: float) -> np.ndarray:
    """Covariance (n, n) of the noise that dx/dt = A x + w gathers over one step.

    Q = integral over one step of exp(A s) W exp(A s)' ds. A noise that enters through L with
    density q has W = L q L'.

    Source: Van Loan (1978), Computing integrals involving the matrix exponential.

    Args:
        A: (n, n), per second.
        noise_density: W, (n, n), spectral density of w: state squared per second.
        time_step_s: the sampling time.

    Raises:
        ValueError: time_step_s <= 0, or the density does not fit A.
    """
    n = _check(A, time_step_s)
    if noise_density.shape != (n, n):
        raise ValueError(
            f"noise density has shape {noise_density.shape}, but A is ({n}, {n}): "
            "pass L @ q @ L.T, in the coordinates of the state"
        )
    block = np.block([[-A, noise_density], [np.zeros((n, n)), A.T]])
    exponential = _expm(block * time_step_s)
    F = exponential[n:, n:].T
    Q = F @ exponential[:n, n:]
    return 0.5 * (Q + Q.T)


def _check(A: np.ndarray, time_step_s: float) -> int:
    if A.ndim != 2 or A.shape[0] != A.shape[1]:
        raise ValueError(f"A has shape {A.shape}, but must be square (n, n)")
    if not time_step_s > 0:
        raise ValueError(f"time_step_s is {time_step_s}, but a sampling time is positive")
    return A.shape[0]


def _expm(matrix: np.ndarray) -> np.ndarray:
    from scipy.linalg import expm  # here, so that a node process never loads scipy

    return expm(matrix)
