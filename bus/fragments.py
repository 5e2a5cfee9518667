"""Data that does not fit into one frame: cut into payloads, and put together when complete.

Every payload begins with four bytes: number of the fragment, number of fragments, length of the
whole (little-endian), so that a receiver needs no other knowledge, and padding falls away.
"""

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache

from concord.bus.bus import Rejected, SharePlace, TooLong


def numbered(data: bytes) -> SharePlace:
    """Return where a fragment says that it belongs in its share.

    Raises:
        Rejected: the fragment is too short to say.
    """
    try:
        frames = fragment_count(data)
    except FragmentError as error:
        raise Rejected(f"fragment-{error.reason}") from None
    return SharePlace(data[0], frames)


def read_body(fragments: Sequence[bytes]) -> bytes:
    """Return the body of a share whose fragments have all come.

    Raises:
        Rejected: they do not belong together.
    """
    try:
        return join(fragments)
    except FragmentError as error:
        raise Rejected(f"fragment-{error.reason}") from None


_PREFIX = struct.Struct("<BBH")
PREFIX_BYTES = _PREFIX.size
MAX_FRAGMENTS = 255


class FragmentError(ValueError):
    """Payloads that are not one complete whole. `reason` is a short code for counters:

    empty, too-short, mixed, repeated, incomplete, length.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


Padded = Callable[[int], int]
"""Bytes -> the shortest payload that a bus has for so many."""


def to_even(size: int) -> int:
    """Return the shortest payload of FlexRay for so many bytes: it counts words of two."""
    return size + size % 2


# Kept: the shares of a network have few lengths.
@lru_cache
def payload_sizes(
    data_bytes: int, payload_limit_bytes: int, padded: Padded = to_even
) -> tuple[int, ...]:
    """Payload lengths in which `data_bytes` travel, each as `padded` allows and at most the limit.

    Raises ValueError if the limit leaves no room for data, or too many frames would be needed.
    """
    limit = payload_limit_bytes
    while limit > 0 and padded(limit) > payload_limit_bytes:
        limit -= 1
    room = limit - PREFIX_BYTES
    if room <= 0:
        raise ValueError(
            f"payloads of {payload_limit_bytes} bytes leave no room for data beside the "
            f"{PREFIX_BYTES} bytes that number the fragments; use a cluster with longer payloads"
        )
    count = max(1, -(-data_bytes // room))
    if count > MAX_FRAGMENTS:
        raise TooLong(
            f"{data_bytes} bytes need {count} frames of {limit} bytes, but at most {MAX_FRAGMENTS} "
            "can be numbered; use shorter shares, or a cluster with longer payloads"
        )
    last = PREFIX_BYTES + data_bytes - (count - 1) * room
    return (limit,) * (count - 1) + (padded(last),)


def split(data: bytes, payload_limit_bytes: int, padded: Padded = to_even) -> tuple[bytes, ...]:
    """Payloads that carry `data`, in order. Raises ValueError as `payload_sizes` does."""
    sizes = payload_sizes(len(data), payload_limit_bytes, padded)
    room = sizes[0] - PREFIX_BYTES
    return tuple(
        (
            _PREFIX.pack(index, len(sizes), len(data)) + data[index * room : (index + 1) * room]
        ).ljust(size, b"\0")
        for index, size in enumerate(sizes)
    )


def fragment_count(payload: bytes) -> int:
    """How many payloads the whole has that this one belongs to. Raises FragmentError."""
    if len(payload) < PREFIX_BYTES:
        raise FragmentError("too-short", f"a payload of {len(payload)} bytes has no number")
    return payload[1]


def join(payloads: Sequence[bytes]) -> bytes:
    """The data of which these are the payloads, in any order, the last of them padded at will.

    Raises FragmentError, and nothing else, for payloads that are not one complete whole.
    """
    if not payloads:
        raise FragmentError("empty", "no payload")
    first = payloads[0]
    count = fragment_count(first)
    parts: dict[int, bytes] = {}
    for payload in payloads:
        if fragment_count(payload) != count or payload[2:4] != first[2:4]:
            raise FragmentError("mixed", "payloads of different wholes")
        if payload[0] in parts:
            raise FragmentError("repeated", f"fragment {payload[0]} came twice")
        parts[payload[0]] = payload[PREFIX_BYTES:]
    if len(parts) != count or max(parts) >= count:
        raise FragmentError("incomplete", f"{len(parts)} of {count} fragments came")
    length = int.from_bytes(first[2:4], "little")
    data = parts[0] if count == 1 else b"".join(parts[number] for number in range(count))
    if len(data) < length:
        raise FragmentError("length", f"{length} bytes announced, but {len(data)} came")
    return data[:length]
