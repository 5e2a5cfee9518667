"""A scan as the bytes of a record: the number of its detections, then the detections, quantised.

A scan without detections is a record of one byte. It says that the sensor looked and saw nothing,
which a missing record does not say.
"""

from dataclasses import dataclass

import numpy as np

_COUNT_BYTES = 1
_MOST_DETECTIONS = 255
_BITS_IN_BYTE = 8
_STEPS_PER_DEVIATION = 2.5
"""At least so many steps of quantisation are in a standard deviation: rounding adds 1.3 % to the
variance of a detection at most."""


@dataclass(frozen=True)
class ScanCodec:
    """How the scans of a node are written: at most `readings` detections.

    A number is a whole multiple of its `resolution` above its `least`, in `bits` bits: (m,) each.
    As readings, a scan is (1 + D, m): a row that begins with the number of detections, the
    detections, and NaN. Rows of NaN alone are no scan. Of a scan with too many detections the
    record has those with the least first number, which are the nearest.
    """

    readings: int
    least: np.ndarray
    resolution: np.ndarray
    bits: tuple[int, ...]

    @property
    def channels(self) -> int:
        """How many numbers m a detection has."""
        return len(self.bits)

    @property
    def size_max(self) -> int:
        """Length in bytes of the longest record."""
        return self._size(self.readings)

    @property
    def rounding_cov(self) -> np.ndarray:
        """Covariance (m, m) of what rounding does, uniform errors: step^2 / 12."""
        return np.diag(self.resolution**2 / 12)

    def encode(self, delivered: np.ndarray) -> bytes | None:
        """The record of a scan; None where there was none."""
        if np.isnan(delivered[0, 0]):
            return None
        detections = delivered[1 : 1 + int(delivered[0, 0])]
        nearest = detections[np.argsort(detections[:, 0], kind="stable")][: self.readings]
        steps = np.rint((nearest - self.least) / self.resolution)
        codes = np.clip(steps, 0, 2 ** np.array(self.bits) - 1).astype(np.int64)
        flags = [
            (codes[:, place, None] >> np.arange(bits)) & 1 for place, bits in enumerate(self.bits)
        ]
        packed = np.packbits(np.concatenate(flags, axis=1).astype(np.uint8))
        return bytes((len(nearest),)) + packed.tobytes()

    def decode(self, record: bytes) -> np.ndarray:
        """Return the scan (1 + readings, m) that a whole record means."""
        return scan_rows(self.detections(record), self.readings)

    def detections(self, record: bytes) -> np.ndarray:
        """The detections (D, m) of a whole record."""
        data = np.frombuffer(record, np.uint8, offset=_COUNT_BYTES)
        width, count = sum(self.bits), record[0]
        flags = np.unpackbits(data, count=count * width).reshape(count, width).astype(np.int64)
        ends = np.cumsum(self.bits)
        codes = [
            flags[:, end - bits : end] @ (1 << np.arange(bits))
            for end, bits in zip(ends, self.bits, strict=True)
        ]
        return self.least + self.resolution * np.stack(codes, axis=-1)

    def received(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the scans (..., 1 + D, m) that readers get, and the lengths (...) of records."""
        found, lengths = np.full(delivered.shape, np.nan), np.zeros(delivered.shape[:-2], int)
        for lane in np.ndindex(*lengths.shape):
            record = self.encode(delivered[lane])
            if record is not None:
                found[lane] = scan_rows(self.detections(record), delivered.shape[-2] - 1)
                lengths[lane] = len(record)
        return found, lengths

    def beyond(self, delivered: np.ndarray) -> np.ndarray:
        """How many detections of scans (..., 1 + D, m) find no room in records, (...)."""
        count = np.nan_to_num(delivered[..., 0, 0]).astype(np.int64)
        return np.maximum(count - self.readings, 0)

    def length(self, data: bytes) -> int:
        """Length of the record that `data` begins with; more than that of `data` if it is cut."""
        count = data[0] if data else 0
        # No node writes more: such a share is refused as one that was cut.
        return self._size(count) if count <= self.readings else len(data) + 1

    def _size(self, detections: int) -> int:
        return _COUNT_BYTES + -(-detections * sum(self.bits) // _BITS_IN_BYTE)


def scan_codec(
    least: np.ndarray, most: np.ndarray, noise_std: np.ndarray, room_bytes: int
) -> ScanCodec:
    """How scans are written in records of `room_bytes`.

    Args:
        least, most: between which the numbers of a detection lie; others go to the nearer one.
        noise_std: of these numbers, (m,) as all.
        room_bytes: length of the longest record.

    Raises:
        ValueError: not even one detection has room.
    """
    bits = np.ceil(np.log2(_STEPS_PER_DEVIATION * (most - least) / noise_std + 1)).astype(int)
    count = min(int((room_bytes - _COUNT_BYTES) * _BITS_IN_BYTE // bits.sum()), _MOST_DETECTIONS)
    if count < 1:
        raise ValueError(
            f"a share has {room_bytes} bytes for a scan, and one detection takes "
            f"{_COUNT_BYTES + -(-int(bits.sum()) // _BITS_IN_BYTE)}; raise --payload-bytes"
        )
    return ScanCodec(count, least, (most - least) / (2**bits - 1), tuple(bits.tolist()))


def scan_rows(detections: np.ndarray, rows: int) -> np.ndarray:
    """Return detections (D, m) as readings (1 + rows, m)."""
    found = np.full((1 + rows, detections.shape[1]), np.nan)
    found[0, 0] = len(detections)
    found[1 : 1 + len(detections)] = detections
    return found
