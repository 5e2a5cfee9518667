"""Linear time-varying plants whose noise is unknown but bounded.

    x[k+1] = A[k] x[k] + B[k] w[k],   y[k] = C[k] x[k] + D[k] w[k],   w[k]' W[k]^-1 w[k] <= 1

One noise drives the state and disturbs the sensors. Everywhere else it is written w = F v with
F F' = W and |v| <= 1: noise in units of its bound.

Source: Liu, Wang, Wang, Wei (2021), Recursive set-membership state estimation over a FlexRay
network, equations (1) and (2).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

MatrixAt = Callable[[int], np.ndarray]


@dataclass(frozen=True, eq=False)
class BoundedSystem:
    """The matrices of a step: A (n, n), B (n, q), C (m, n), D (m, q), W (q, q)."""

    transition: MatrixAt
    noise_input: MatrixAt
    output: MatrixAt
    feedthrough: MatrixAt
    noise_shape: MatrixAt

    def scaled_noise_input(self, step: int) -> np.ndarray:
        """B F (n, q): what noise in units of its bound does to the state."""
        return self.noise_input(step) @ self.noise_factor(step)

    def scaled_feedthrough(self, step: int) -> np.ndarray:
        """D F (m, q): what it does to the outputs."""
        return self.feedthrough(step) @ self.noise_factor(step)

    def noise_factor(self, step: int) -> np.ndarray:
        """F (q, q) with F F' = W; W may be singular.

        Raises:
            ValueError: W is not a shape: not symmetric, or with a negative eigenvalue.
        """
        shape = self.noise_shape(step)
        values, vectors = np.linalg.eigh(shape)
        if not np.allclose(shape, shape.T) or values[0] < -1e-12 * max(values[-1], 0.0):
            raise ValueError(
                f"the noise shape W of step {step} has the least eigenvalue {values[0]:.3g}; give "
                "a symmetric matrix without negative eigenvalues, so that w' W^-1 w <= 1 is a bound"
            )
        if values[0] > 1e-12 * values[-1]:
            return np.linalg.cholesky(shape).astype(np.float64)
        root: np.ndarray = vectors * np.sqrt(np.maximum(values, 0.0))
        return root

    def majorant(self) -> "BoundedSystem":
        """Return the system of the magnitudes, with one noise of size one: what its states and
        outputs reach bounds those of this system entry by entry, and so bounds their rounding."""
        return BoundedSystem(
            transition=lambda step: np.abs(self.transition(step)),
            noise_input=lambda step: _lengths(self.scaled_noise_input(step)),
            output=lambda step: np.abs(self.output(step)),
            feedthrough=lambda step: _lengths(self.scaled_feedthrough(step)),
            noise_shape=lambda _: np.eye(1),
        )

    def advance(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """States (..., n) one step later, under noise (..., q) in units of its bound."""
        moved = state @ self.transition(step).T
        return moved + noise @ self.scaled_noise_input(step).T

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Outputs (..., m) of states (..., n), disturbed by the same noise (..., q)."""
        return state @ self.output(step).T + noise @ self.scaled_feedthrough(step).T

    def simulate(
        self, initial_state: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """States (..., steps + 1, n) from (..., n) on and outputs (..., steps, m).

        Args:
            initial_state: (..., n).
            noise: (..., steps, q), in units of its bound.
        """
        states, outputs = [initial_state], []
        for step in range(noise.shape[-2]):
            now = noise[..., step, :]
            outputs.append(self.observe(states[-1], now, step))
            states.append(self.advance(states[-1], now, step))
        return np.stack(states, axis=-2), np.stack(outputs, axis=-2)


def _lengths(matrix: np.ndarray) -> np.ndarray:
    """Lengths of the rows (rows, 1)."""
    return np.sqrt((matrix**2).sum(-1, keepdims=True))
