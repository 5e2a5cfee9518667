"""A Gaussian as bytes: the mean, then the upper triangle of the covariance row by row."""

import math
import struct
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

    @cached_property
    def _numbers(self) -> struct.Struct:
        return struct.Struct(f"<{self.size // self._dtype.itemsize}{self._dtype.char}")

    def encode(self, belief: Gaussian) -> bytes:
        """The bytes of mean (n,) and cov (n, n)."""
        packed = np.concatenate((belief.mean, pack_upper(belief.cov)))
        return packed.astype(self._dtype, copy=False).tobytes()

    def check(self, body: bytes) -> bytes:
        """A body without what pads it, of which a belief can be read.

        Raises:
            Rejected: `belief-length` or `belief-not-finite`.
        """
        # A static slot may pad the body; anything shorter is not a belief of this network.
        size = self.size
        if len(body) < size:
            raise Rejected("belief-length")
        body = body[:size]
        # Finite numbers may have an infinite sum, but no sum of others is finite.
        numbers = self._numbers.unpack(body)
        if not (math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))):
            raise Rejected("belief-not-finite")
        return body

    def unpack(self, *bodies: bytes) -> Gaussian:
        """The beliefs (K, n) in K bodies that were checked."""
        numbers = np.frombuffer(b"".join(bodies), self._dtype).astype(np.float64, copy=False)
        numbers = numbers.reshape(len(bodies), -1)
        return Gaussian(numbers[:, : self.states], unpack_upper(numbers[:, self.states :]))

    def decode(self, body: bytes) -> Gaussian:
        """The belief that `encode` wrote.

        Raises:
            Rejected: `belief-length` or `belief-not-finite`.
        """
        mean, cov = self.unpack(self.check(body))
        return Gaussian(mean[0], cov[0])
