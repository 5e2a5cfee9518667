"""A node's readings of one step as the bytes of a record: quantised, the same for every reader.

Every node that uses a record uses these bytes, the source too. So all nodes count the rounding
error as the same noise.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from concord.nodes.rules.local_filter import Sensor

# Steps of quantisation in a standard deviation of the noise, and those of packed numbers.
_STEPS_PER_DEVIATION = 16
_PACKED_STEPS = 4
PACKED = "i12"
"""Type code of integers of 12 bits; all others are those of numpy."""
_PACKED_BITS = 12


@runtime_checkable
class Calibrated(Protocol):
    """A sensor whose reading is the measurement itself, with noise known before it is taken."""

    @property
    def noise_std(self) -> np.ndarray:
        """Standard deviation of each entry, () or (m,); a delivery beyond m is NaN."""
        ...


class RecordForm(Protocol):
    """A form in which the readings of a node at a step are written, the same for all readers."""

    @property
    def readings(self) -> int:
        """The most readings in a record."""
        ...

    @property
    def channels(self) -> int:
        """How many numbers a reading has."""
        ...

    @property
    def size_max(self) -> int:
        """Length in bytes of the longest record."""
        ...

    @property
    def rounding_cov(self) -> np.ndarray | None:
        """Covariance (channels, channels) of what rounding does; None where nothing is rounded."""
        ...

    def encode(self, delivered: np.ndarray) -> bytes | None:
        """The record of readings (r, d); None where there is nothing to say."""
        ...

    def received(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return readings (..., r, d) as readers get them, and lengths (...); 0 for no record."""
        ...

    def beyond(self, delivered: np.ndarray) -> np.ndarray:
        """How much of readings (..., r, d) a record cannot say, (...)."""
        ...

    def decode(self, record: bytes) -> np.ndarray:
        """The readings (r, d) that a whole record means."""
        ...

    def length(self, data: bytes) -> int:
        """Length of the record that `data` begins with; more than that of `data` if it is cut."""
        ...


@dataclass(frozen=True)
class RecordCodec:
    """How the readings (r, d) of a node at a step are written.

    The first `channels` of d entries are what the node measures; `padding` more, for which others
    have sensors, are always NaN and not written. `number` is a numpy type code or `PACKED`; with an
    integer one an entry is a multiple of its `resolution` (channels,), and the least integer stands
    for NaN.
    """

    readings: int
    channels: int
    number: str
    resolution: np.ndarray | None
    padding: int = 0

    @property
    def size_max(self) -> int:
        """Length in bytes of a record of which no reading is missing."""
        return self._mask_bytes + self.readings * self._reading_bytes

    @property
    def rounding_cov(self) -> np.ndarray | None:
        """Covariance (channels, channels) of what rounding does, uniform errors: step^2 / 12."""
        return None if self.resolution is None else np.diag(self.resolution**2 / 12)

    def encode(self, delivered: np.ndarray) -> bytes | None:
        """The record of readings (r, d); None where nothing was taken, or nothing can be said.

        An entry beyond the range of an integer is left out, as if it had not been taken.
        """
        entries, taken = self._entries(delivered)
        if not taken.any():
            return None
        mask = b"" if self.readings == 1 else np.packbits(taken, bitorder="little").tobytes()
        return mask + self._written(entries[taken])

    def received(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the readings (..., r, d) that readers of the record get: NaN if not written.

        Return also the lengths (...) of the records in bytes; 0 where there is none.
        """
        entries, taken = self._entries(delivered)
        found = np.full(delivered.shape, np.nan)
        data = np.where(taken[..., None], entries, 0).astype(self._array_type)
        found[..., : self.channels] = np.where(taken[..., None], self._values(data), np.nan)
        count = np.asarray(taken.sum(axis=-1))
        return found, np.where(count > 0, self._mask_bytes + count * self._reading_bytes, 0)

    def _entries(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the entries written of readings (..., r, d), and of which readings (..., r)."""
        delivered = delivered[..., : self.channels]
        if self.resolution is None:
            return delivered, np.asarray(~np.isnan(delivered).all(axis=-1))
        most = self._most
        codes = np.round(delivered / self.resolution)
        entries = np.where(np.abs(codes) <= most, codes, -most - 1)
        return entries, np.asarray((entries >= -most).any(axis=-1))

    def _values(self, data: np.ndarray) -> np.ndarray:
        """Return the values of written entries (..., channels)."""
        values = data.astype(np.float64)
        if self.resolution is None:
            return values
        return np.where(data < -self._most, np.nan, values) * self.resolution

    def beyond(self, delivered: np.ndarray) -> np.ndarray:
        """How many entries of readings (..., r, d) no integer can say, (...)."""
        if self.resolution is None:
            return np.zeros(delivered.shape[:-2], dtype=np.int64)
        codes = np.abs(np.round(delivered[..., : self.channels] / self.resolution))
        return (codes > self._most).sum(axis=(-1, -2))

    def decode(self, record: bytes) -> np.ndarray:
        """The readings (r, d) that a whole record means."""
        values = self._values(self._read(record[self._mask_bytes :]))
        if self.readings == 1 and not self.padding:
            return values
        delivered = np.full((self.readings, self.channels + self.padding), np.nan)
        taken = slice(None) if self.readings == 1 else self._taken(record)
        delivered[taken, : self.channels] = values
        return delivered

    def length(self, data: bytes) -> int:
        """Length of the record that `data` begins with; more than that of `data` if it is cut."""
        if self.readings == 1:
            return self._reading_bytes
        if len(data) < self._mask_bytes:
            return self._mask_bytes
        return self._mask_bytes + int(self._taken(data).sum()) * self._reading_bytes

    @cached_property
    def _mask_bytes(self) -> int:
        return 0 if self.readings == 1 else -(-self.readings // 8)

    @cached_property
    def _reading_bytes(self) -> int:
        return reading_bytes(self.channels, self.number)

    @cached_property
    def _array_type(self) -> str:
        return "<i2" if self.number == PACKED else self.number

    @cached_property
    def _most(self) -> int:
        """The greatest integer of a record."""
        if self.number == PACKED:
            return 2 ** (_PACKED_BITS - 1) - 1
        return int(np.iinfo(self.number).max)

    def _written(self, entries: np.ndarray) -> bytes:
        """The bytes of entries (k, channels)."""
        data = entries.astype(self._array_type)
        if self.number != PACKED:
            return data.tobytes()
        bits = data[..., None] >> np.arange(_PACKED_BITS) & 1
        flat = bits.reshape(len(data), -1).astype(np.uint8)
        return np.packbits(flat, axis=-1, bitorder="little").tobytes()

    def _read(self, data: bytes) -> np.ndarray:
        """The entries (k, channels) that were written; an inverse of `_written`."""
        if self.number != PACKED:
            return np.frombuffer(data, self.number).reshape(-1, self.channels)
        rows = np.frombuffer(data, np.uint8).reshape(-1, self._reading_bytes)
        count = self.channels * _PACKED_BITS
        bits = np.unpackbits(rows, axis=-1, count=count, bitorder="little")
        codes = bits.reshape(len(rows), self.channels, _PACKED_BITS) @ (
            1 << np.arange(_PACKED_BITS)
        )
        return np.where(codes > self._most, codes - 2**_PACKED_BITS, codes)

    def _taken(self, record: bytes) -> np.ndarray:
        """Which of several readings (r,) a record has."""
        mask = np.frombuffer(record[: self._mask_bytes], np.uint8)
        return np.unpackbits(mask, count=self.readings, bitorder="little").astype(bool)


def reading_bytes(channels: int, number: str) -> int:
    """Length of a reading of so many numbers."""
    bits = _PACKED_BITS if number == PACKED else 8 * np.dtype(number).itemsize
    return -(-channels * bits // 8)


def record_codec(sensor: Sensor | None, shape: tuple[int, int], number: str) -> RecordCodec | None:
    """How the readings (r, d) = `shape` of a node with this sensor are written; None without one.

    Readings of a sensor that is not `Calibrated` mean what they mean together (a sighting from a
    moving robot): they go as float32 where an integer is asked for.
    """
    if sensor is None:
        return None
    readings, delivered = shape
    is_integer = number == PACKED or np.dtype(number).kind == "i"
    whole = "<f4" if is_integer else number
    if not isinstance(sensor, Calibrated):
        return RecordCodec(readings, delivered, whole, None)
    deviation = np.asarray(sensor.noise_std, dtype=float)
    deviation = np.broadcast_to(deviation, deviation.shape or (delivered,))
    channels = len(deviation)
    padding = delivered - channels
    if not is_integer:
        return RecordCodec(readings, channels, number, None, padding)
    # An entry that there is nothing to measure with is NaN in every reading, whatever its step.
    deviation = np.where(np.isnan(deviation), 1.0, deviation)
    steps = _PACKED_STEPS if number == PACKED else _STEPS_PER_DEVIATION
    return RecordCodec(readings, channels, number, deviation / steps, padding)
