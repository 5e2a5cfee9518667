"""A node's readings of one step as the bytes of a record: quantised, the same for every reader.

Every node that uses a record uses these bytes, the source too. So all nodes count the rounding
error as the same noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from concord.nodes.rules.local_filter import Sensor

# Steps of quantisation in a standard deviation of the noise, and those of packed numbers.
_STEPS_PER_DEVIATION = 16
_PACKED_STEPS = 4
PACKED = "i12"
"""Type code of integers of 12 bits; all others are those of numpy."""
_PACKED_BITS = 12
# A float32 holds so many deviations with an error below a thousandth of one.
_SINGLE, _SINGLE_REACH = 2.0**-24, 2.0**14


@runtime_checkable
class Calibrated(Protocol):
    """A sensor whose reading is the measurement itself, with noise known before it is taken."""

    @property
    def noise_std(self) -> np.ndarray:
        """Standard deviation of each entry, () or (m,); a delivery beyond m is NaN."""
        ...


class Reference(NamedTuple):
    """A reading (channels,) that all nodes know, and the `residual` of two readings of its
    sensor."""

    reading: np.ndarray
    residual: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def difference(self, readings: np.ndarray) -> np.ndarray:
        """Return readings (..., channels) less this one, angles wrapped."""
        return self.residual(readings, np.broadcast_to(self.reading, readings.shape))


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
    have sensors, are always NaN and not written. `number` is a numpy type code or `PACKED`. An
    entry is its difference to the `reference`, and with an integer a multiple of its `resolution`
    (channels,); the least integer stands for NaN. A reading with an entry farther from the
    reference than the integers reach, or a float32 may be by `reach` (channels,), says so in its
    first entry, and follows as float64.
    """

    readings: int
    channels: int
    number: str
    resolution: np.ndarray | None
    padding: int = 0
    reference: Reference | None = None
    reach: np.ndarray | float = np.inf

    @property
    def size_max(self) -> int:
        """Length in bytes of a record of which no reading is missing."""
        far_bytes = self._far_bytes if self._has_reach else 0
        return self._mask_bytes + self.readings * (self._reading_bytes + far_bytes)

    @property
    def rounding_cov(self) -> np.ndarray | None:
        """Covariance (channels, channels) of what rounding does: step^2 / 12, as of uniform errors.

        The step of a float32 is that of its farthest entries.
        """
        if self.resolution is not None:
            return np.diag(self.resolution**2 / 12)
        if not self._has_reach:
            return None
        return np.diag((2.0 * _SINGLE * np.broadcast_to(self.reach, self.channels)) ** 2 / 12)

    def encode(self, delivered: np.ndarray) -> bytes | None:
        """The record of readings (r, d); None where nothing was taken."""
        entries, taken, far = self._entries(delivered)
        if not taken.any():
            return None
        mask = b"" if self.readings == 1 else np.packbits(taken, bitorder="little").tobytes()
        if not far.any():
            return mask + self._written(entries[taken])
        exact = delivered[..., : self.channels].astype("<f8")
        return mask + b"".join(
            self._written(entries[place, None]) + (exact[place].tobytes() if far[place] else b"")
            for place in np.flatnonzero(taken)
        )

    def received(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the readings (..., r, d) that readers of the record get: NaN if not written.

        Return also the lengths (...) of the records in bytes; 0 where there is none.
        """
        entries, taken, far = self._entries(delivered)
        found = np.full(delivered.shape, np.nan)
        data = np.where(taken[..., None], entries, 0).astype(self._array_type)
        values = np.where(far[..., None], delivered[..., : self.channels], self._values(data))
        found[..., : self.channels] = np.where(taken[..., None], values, np.nan)
        count = np.asarray(taken.sum(axis=-1))
        lengths = self._mask_bytes + count * self._reading_bytes
        return found, np.where(count > 0, lengths + far.sum(axis=-1) * self._far_bytes, 0)

    def _entries(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the entries written of readings (..., r, d), which readings (..., r) are taken,
        and which of them follow as float64."""
        entries = delivered[..., : self.channels]
        taken = np.asarray(~np.isnan(entries).all(axis=-1))
        if self.reference is not None:
            entries = self.reference.difference(entries)
        far = np.asarray((np.abs(entries) > self._reach).any(axis=-1))
        if self.resolution is not None:
            codes = np.round(np.where(far[..., None], np.nan, entries) / self.resolution)
            entries = np.where(np.isnan(codes), -self._most - 1, codes)
        if far.any():
            entries = np.where(far[..., None], self._far_mark, entries)
        return entries, taken, far

    def _values(self, data: np.ndarray) -> np.ndarray:
        """Return the values of written entries (..., channels)."""
        values = data.astype(np.float64)
        if self.resolution is not None:
            values = np.where(data < -self._most, np.nan, values) * self.resolution
        return values if self.reference is None else self.reference.reading + values

    def beyond(self, delivered: np.ndarray) -> np.ndarray:
        """How many of readings (..., r, d) follow as float64, (...)."""
        return self._entries(delivered)[2].sum(axis=-1)

    def decode(self, record: bytes) -> np.ndarray:
        """The readings (r, d) that a whole record means."""
        starts, far, _ = self._layout(record)
        written = b"".join(record[start : start + self._reading_bytes] for start in starts)
        values = self._values(self._read(written))
        for place in np.flatnonzero(far):
            exact = starts[place] + self._reading_bytes
            values[place] = np.frombuffer(record, "<f8", self.channels, exact)
        if self.readings == 1 and not self.padding:
            return values
        delivered = np.full((self.readings, self.channels + self.padding), np.nan)
        taken = slice(None) if self.readings == 1 else self._taken(record)
        delivered[taken, : self.channels] = values
        return delivered

    def length(self, data: bytes) -> int:
        """Length of the record that `data` begins with; more than that of `data` if it is cut."""
        if len(data) < self._mask_bytes:
            return self._mask_bytes
        return self._layout(data)[2]

    def _layout(self, data: bytes) -> tuple[list[int], list[bool], int]:
        """Where the readings of a record begin, which follow as float64, and where it ends."""
        count = 1 if self.readings == 1 else int(self._taken(data).sum())
        starts, far, end = [], [], self._mask_bytes
        for _ in range(count):
            starts.append(end)
            end += self._reading_bytes
            is_far = end <= len(data) and self._is_far(data[starts[-1] : end])
            far.append(is_far)
            end += is_far * self._far_bytes
        return starts, far, end

    def _is_far(self, reading: bytes) -> bool:
        return self._has_reach and bool(self._read(reading)[0, 0] == self._far_mark)

    @cached_property
    def _reach(self) -> np.ndarray | float:
        return self.reach if self.resolution is None else (self._most - 1) * self.resolution

    @cached_property
    def _has_reach(self) -> bool:
        return not np.isposinf(self._reach).all()

    @property
    def _far_mark(self) -> float:
        """The first entry of a reading that follows as float64: no other has it."""
        return np.inf if self.resolution is None else -self._most

    @property
    def _far_bytes(self) -> int:
        return 8 * self.channels

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
        return _greatest(self.number)

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


def record_codec(
    sensor: Sensor | None,
    shape: tuple[int, int],
    number: str,
    origin: np.ndarray | None = None,
) -> RecordCodec | None:
    """How the readings (r, d) = `shape` of a node with this sensor are written; None without one.

    Readings of a sensor that is not `Calibrated` mean what they mean together (a sighting from a
    moving robot): they go as float32 where an integer is asked for. Others go about the reading of
    the state `origin` (n,), if one is given. An entry without noise leaves no room for rounding, so
    that its sensor's readings go as float64.
    """
    if sensor is None:
        return None
    readings, delivered = shape
    is_integer = number == PACKED or np.dtype(number).kind == "i"
    if not isinstance(sensor, Calibrated):
        return RecordCodec(readings, delivered, "<f4" if is_integer else number, None)
    deviation = np.asarray(sensor.noise_std, dtype=float)
    deviation = np.broadcast_to(deviation, deviation.shape or (delivered,))
    channels = len(deviation)
    padding = delivered - channels
    if number == "<f8" or (deviation == 0).any():
        return RecordCodec(readings, channels, "<f8", None, padding)
    # An entry that there is nothing to measure with is NaN in every reading, whatever its step.
    deviation = np.where(np.isnan(deviation), 1.0, deviation)
    reference = None if origin is None else _reference(sensor, origin)
    if not is_integer:
        reach = _SINGLE_REACH * deviation
        return RecordCodec(readings, channels, number, None, padding, reference, reach)
    resolution = deviation / (_PACKED_STEPS if number == PACKED else _STEPS_PER_DEVIATION)
    return RecordCodec(readings, channels, number, resolution, padding, reference)


def _reference(sensor: Sensor, origin: np.ndarray) -> Reference:
    """The reading of a state (n,); 0 where it is not finite."""
    reading = np.asarray(sensor.measure(origin, 0), dtype=float)
    return Reference(np.where(np.isfinite(reading), reading, 0.0), sensor.residual)


def _greatest(number: str) -> int:
    """The greatest integer of a record."""
    return 2 ** (_PACKED_BITS - 1) - 1 if number == PACKED else int(np.iinfo(number).max)
