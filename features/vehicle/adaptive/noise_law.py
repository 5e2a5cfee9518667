"""The interface of a law by which a filter learns the noise of a sensor; what the law is told."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

Memory = TypeVar("Memory")


class ReadingEvidence(NamedTuple):
    """Evidence of a reading about its noise, in standard deviations of the data sheet, and squared.

    Attributes:
        innovation: (..., m), reading minus prediction; NaN for a channel that was not taken.
        expected: (..., m), its variance with the noise learnt so far.
        unexplained: the reading minus the prediction of the posterior, and the variance of that
            prediction, (..., m) each. It evaluates the measurement model at the posterior.
    """

    innovation: np.ndarray
    expected: np.ndarray
    unexplained: Callable[[], tuple[np.ndarray, np.ndarray]]


class NoiseLaw(Protocol[Memory]):
    """A law by which the noise of a sensor is learnt."""

    def begin(self, shape: tuple[int, ...]) -> Memory:
        """The memory before the first reading (..., m) of this shape."""
        ...

    def factors(self, memory: Memory) -> np.ndarray:
        """Variances learnt over those of the data sheet, (..., m)."""
        ...

    def adapt(self, memory: Memory, evidence: ReadingEvidence) -> Memory:
        """The memory after one reading more; NaN leaves a channel alone."""
        ...
