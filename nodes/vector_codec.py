"""A vector of numbers as bytes."""

import math
import struct
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from concord.nodes.estimator import Rejected


@dataclass(frozen=True)
class VectorCodec:
    """How a vector of `length` numbers is written; `number` is "<f8" or "<f4".

    A body that is no such vector is refused as `{what}-length` or `{what}-not-finite`.
    """

    length: int
    number: str = "<f8"
    what: str = "share"

    @cached_property
    def size(self) -> int:
        """Length in bytes of an encoded vector."""
        return self.length * self._dtype.itemsize

    @cached_property
    def _dtype(self) -> np.dtype:
        return np.dtype(self.number)

    @cached_property
    def _numbers(self) -> struct.Struct:
        return struct.Struct(f"<{self.length}{self._dtype.char}")

    def encode(self, vector: np.ndarray) -> bytes:
        """The bytes of a vector (length,)."""
        return vector.astype(self._dtype, copy=False).tobytes()

    def check(self, body: bytes) -> bytes:
        """A body without its padding, of which a vector can be read.

        Raises:
            Rejected: the body is too short, or a number is not finite.
        """
        # A static slot may pad the body; anything shorter is not a share of this network.
        size = self.size
        if len(body) < size:
            raise Rejected(f"{self.what}-length")
        body = body[:size]
        # Finite numbers may have an infinite sum, but no sum of others is finite.
        numbers = self._numbers.unpack(body)
        if not (math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))):
            raise Rejected(f"{self.what}-not-finite")
        return body

    def unpack(self, *bodies: bytes) -> np.ndarray:
        """The vectors (K, length) in K bodies that were checked."""
        numbers = np.frombuffer(b"".join(bodies), self._dtype).astype(np.float64, copy=False)
        return numbers.reshape(len(bodies), self.length)

    def decode(self, body: bytes) -> np.ndarray:
        """The vector (length,) that `encode` wrote.

        Raises:
            Rejected: as `check`.
        """
        return self.unpack(self.check(body))[0]
