"""Systems with stochastic nonlinearities, seen by sensors that may measure vectors.

    x[s+1] = f(x[s], u[s], s) + g(x[s], eta[s]) + w[s]
    y[s] = h(x[s], s) + b(x[s], zeta[s]) + v[s]

g and b are sums of terms A Z B x with a matrix Z of independent standard normal numbers. So
E{g | x} = 0 and E{g g' | x} = sum_t Pi_t x' Gamma_t x with Pi = A A', Gamma = B' B. Any second
moment of that form has such a term. Source: Meng et al. (2025), UKF for nonlinear systems with
stochastic nonlinearities under FlexRay protocol, equation (1).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np


class Term(NamedTuple):
    """A Z B x: A (d, p) and B (q, n)."""

    outer: np.ndarray
    inner: np.ndarray

    @property
    def numbers(self) -> int:
        """Return how many normal numbers p q it consumes."""
        return self.outer.shape[-1] * self.inner.shape[0]

    def value(self, state: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Return the term (..., d) at states (..., n) for noise (..., p q)."""
        matrix = noise.reshape(*noise.shape[:-1], self.outer.shape[-1], self.inner.shape[0])
        return ((matrix @ (state @ self.inner.T)[..., None])[..., 0]) @ self.outer.T


class NoiseSecondMoment(NamedTuple):
    """sum_t pi_t x' gamma_t x: pi (terms, d, d), gamma (terms, n, n)."""

    pi: np.ndarray
    gamma: np.ndarray


@dataclass(frozen=True, eq=False)
class StochasticNonlinearity:
    """A sum of terms for `size` components of a function of `states` states; none is zero.

    Raises:
        ValueError: a term does not have that shape.
    """

    size: int
    states: int
    terms: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        for number, (outer, inner) in enumerate(self.terms):
            if outer.shape[:1] != (self.size,) or inner.shape[1:] != (self.states,):
                raise ValueError(
                    f"term {number} of a stochastic nonlinearity has A {outer.shape} and B "
                    f"{inner.shape}, but must have A ({self.size}, p) and B (q, {self.states})"
                )

    @property
    def numbers(self) -> int:
        """Return how many standard normal numbers one value consumes."""
        return sum(term.numbers for term in self.terms)

    @cached_property
    def second_moment(self) -> NoiseSecondMoment:
        """Pi_t and Gamma_t of all terms."""
        return NoiseSecondMoment(
            np.array([term.outer @ term.outer.T for term in self.terms]).reshape(
                -1, self.size, self.size
            ),
            np.array([term.inner.T @ term.inner for term in self.terms]).reshape(
                -1, self.states, self.states
            ),
        )

    def value(self, state: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Return the sum (..., d) at states (..., n) for standard normal noise (..., numbers)."""
        total = np.zeros((*np.broadcast_shapes(state.shape[:-1], noise.shape[:-1]), self.size))
        first = 0
        for term in self.terms:
            total += term.value(state, noise[..., first : first + term.numbers])
            first += term.numbers
        return total


@dataclass(frozen=True, eq=False)
class StochasticSystem:
    """Everything about such a system. Whatever is a function of the step may vary with time.

    Attributes:
        transition: f, (state (..., n), control (..., p) or None, step) -> (..., n).
        measure: h of all sensors, (state (..., n), step) -> (..., m).
        sizes: m_1..m_N, how the measurement is cut into those of the sensors.
        process_noise_cov, measurement_noise_cov: step -> Q (n, n) or R (m, m), positive definite.
        process, measurement: step -> g, b; the numbers they consume must not vary.
    """

    transition: Callable[[np.ndarray, np.ndarray | None, int], np.ndarray]
    measure: Callable[[np.ndarray, int], np.ndarray]
    sizes: tuple[int, ...]
    process_noise_cov: Callable[[int], np.ndarray]
    measurement_noise_cov: Callable[[int], np.ndarray]
    process: Callable[[int], StochasticNonlinearity]
    measurement: Callable[[int], StochasticNonlinearity]

    def process_moment(self, step: int) -> NoiseSecondMoment:
        """Return the second moment of g at a step."""
        return self.process(step).second_moment

    def measurement_moment(self, step: int) -> NoiseSecondMoment:
        """Return the second moment of b at a step."""
        return self.measurement(step).second_moment

    @property
    def entries(self) -> int:
        """Length m of a measurement."""
        return sum(self.sizes)

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """States (..., n) one step later, for standard normal noise (..., n + numbers of g)."""
        n = state.shape[-1]
        factor = np.linalg.cholesky(self.process_noise_cov(step))
        return (
            self.transition(state, control, step)
            + self.process(step).value(state, noise[..., n:])
            + noise[..., :n] @ factor.T
        )

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Measurements (..., m) of states (..., n), for noise (..., m + numbers of b)."""
        m = self.entries
        factor = np.linalg.cholesky(self.measurement_noise_cov(step))
        return (
            self.measure(state, step)
            + self.measurement(step).value(state, noise[..., m:])
            + noise[..., :m] @ factor.T
        )
