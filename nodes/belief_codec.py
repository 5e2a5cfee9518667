"""A Gaussian as bytes: the mean, then the upper triangle of the covariance row by row."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import pack_upper, unpack_upper
from nodes.estimator import Rejected


@dataclass(frozen=True)
class BeliefCodec:
    """How a belief of `states` dimensions is written; `number` is "<f8" or "<f4"."""

    states: int
    number: str = "<f8"

    @cached_property
    def size(self) -> int:
        """Length in bytes of an encoded belief."""
        n = self.states
        return (n + n * (n + 1) // 2) * self._dtype.itemsize

    @cached_property
    def _dtype(self) -> np.dtype:
        return np.dtype(self.number)

    def encode(self, belief: Gaussian) -> bytes:
        """The bytes of mean (n,) and cov (n, n)."""
        packed = np.concatenate((belief.mean, pack_upper(belief.cov)))
        return packed.astype(self._dtype, copy=False).tobytes()

    def read(self, body: bytes) -> np.ndarray:
        """The numbers (m,) of the belief that `encode` wrote: mean, then upper triangle.

        Raises:
            Rejected: `belief-length` or `belief-not-finite`.
        """
        # A static slot may pad the body; anything shorter is not a belief of this network.
        size = self.size
        if len(body) < size:
            raise Rejected("belief-length")
        numbers = np.frombuffer(body[:size], self._dtype).astype(np.float64, copy=False)
        # Finite numbers may have an infinite sum, but no sum of others is finite.
        if not (math.isfinite(sum(numbers.tolist())) or np.isfinite(numbers).all()):
            raise Rejected("belief-not-finite")
        return numbers

    def unpack(self, numbers: np.ndarray) -> Gaussian:
        """The beliefs (..., n) of which numbers (..., m) are read."""
        return Gaussian(numbers[..., : self.states], unpack_upper(numbers[..., self.states :]))

    def decode(self, body: bytes) -> Gaussian:
        """The belief that `encode` wrote. Raises Rejected as `read` does."""
        return self.unpack(self.read(body))
