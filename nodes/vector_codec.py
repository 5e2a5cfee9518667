"""A vector of numbers as bytes."""

from typing import NamedTuple

import numpy as np

from nodes.estimator import Rejected
from nodes.messages import Array


class VectorCodec(NamedTuple):
    """How a vector of `length` numbers is written; `number` is "<f8" or "<f4"."""

    length: int
    number: str = "<f8"

    @property
    def size(self) -> int:
        """Length in bytes of an encoded vector."""
        return self.length * np.dtype(self.number).itemsize

    def encode(self, vector: Array) -> bytes:
        """The bytes of a vector (length,)."""
        return vector.astype(self.number, copy=False).tobytes()

    def decode(self, body: bytes) -> Array:
        """The vector (length,) that `encode` wrote.

        Raises:
            Rejected: `share-length` or `share-not-finite`.
        """
        # A static slot may pad the body; anything shorter is not a share of this network.
        if len(body) < self.size:
            raise Rejected("share-length")
        vector = np.frombuffer(body[: self.size], dtype=self.number).astype(np.float64)
        if not np.isfinite(vector).all():
            raise Rejected("share-not-finite")
        return vector
