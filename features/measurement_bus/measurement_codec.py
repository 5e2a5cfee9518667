"""A measurement as bytes."""

from typing import NamedTuple

import numpy as np

from concord.nodes.estimator import Rejected


class MeasurementCodec(NamedTuple):
    """A measurement of at most `entries` numbers as bytes; `number` is "<f8" or "<f4".

    Missing entries are NaN, at the end of a short measurement or throughout: a static slot comes
    round even when there is nothing to send.
    """

    entries: int
    number: str = "<f8"

    @property
    def size(self) -> int:
        """Length in bytes of an encoded measurement."""
        return self.entries * np.dtype(self.number).itemsize

    def encode(self, measurement: np.ndarray) -> bytes:
        """The bytes of a measurement (size of the sensor,)."""
        padded = np.full(self.entries, np.nan)
        padded[: len(measurement)] = measurement
        return padded.astype(self.number).tobytes()

    def decode(self, body: bytes) -> np.ndarray:
        """The measurement (entries,) that `encode` wrote.

        Raises:
            Rejected: `measurement-length` or `measurement-infinite`.
        """
        if len(body) < self.size:
            raise Rejected("measurement-length")
        values = np.frombuffer(body[: self.size], dtype=self.number).astype(np.float64)
        if np.isinf(values).any():
            raise Rejected("measurement-infinite")
        return values
