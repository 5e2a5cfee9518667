"""Share of the rule `labelled`: labelled records, at times a checkpoint, a digest.

    flags u8 (1: I need a checkpoint, 2: here is one, 4: I am lost) | number of records u8
    | digest | checkpoint: mean, upper covariance, float32 | records: source u8, age u8, readings

The step is not written: a share belongs to the cycle that its frame says, and so to its step. Bit
a N + j of the digest means "I hold the record of source j of a steps ago".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.belief_codec import BeliefCodec
from concord.nodes.estimator import Rejected
from concord.nodes.rules.record_codec import RecordCodec

Size = TypeVar("Size", int, np.ndarray)

MAX_SOURCES = 256
MAX_WINDOW_STEPS = 255
_NEED, _CHECKPOINT, _SUSPECT = 1, 2, 4
_HEAD_BYTES = 2
_LABEL_BYTES = 2
_MAX_RECORDS = 255


class Labelled(NamedTuple):
    """A record with its label: its source, and its age in steps."""

    source: int
    age: int
    record: bytes


class LabelledShare(NamedTuple):
    """Content of a node's share.

    `needs` a checkpoint; `digest` is one set of sources per age, as bits; `checkpoint` is its
    belief at the base of the window; `suspect`: its records do not fit its belief.
    """

    needs: bool
    checkpoint: Gaussian | None
    digest: tuple[int, ...]
    records: tuple[Labelled, ...]
    suspect: bool = False


@dataclass(frozen=True)
class LabelledFrameCodec:
    """How a share is written by any node of a network.

    `codecs` has one entry per source, None for a node without a sensor.

    Raises:
        ValueError: a share of `limit_bytes` does not hold a checkpoint, or not every record.
    """

    codecs: Sequence[RecordCodec | None]
    belief: BeliefCodec
    window_steps: int
    digest_steps: int
    limit_bytes: int

    def __post_init__(self) -> None:
        longest = _LABEL_BYTES + max((codec.size_max for codec in self.codecs if codec), default=0)
        check_limit(
            self.limit_bytes, len(self.codecs), self.digest_steps, max(self.belief.size, longest)
        )

    @property
    def digest_bytes(self) -> int:
        """Length of a digest."""
        return _digest_bytes(len(self.codecs), self.digest_steps)

    def room(self, with_checkpoint: bool) -> int:
        """Bytes left for records."""
        taken = _HEAD_BYTES + self.digest_bytes + (self.belief.size if with_checkpoint else 0)
        return self.limit_bytes - taken

    @staticmethod
    def cost(record_bytes: Size) -> Size:
        """Bytes that a record of that length, or records of those (...), take in a frame."""
        return _LABEL_BYTES + record_bytes

    def encode(self, share: LabelledShare) -> bytes:
        """The bytes of a share with at most 255 records."""
        assert len(share.records) <= _MAX_RECORDS, "a record takes at least four bytes of 254"
        flags = _NEED * share.needs + _CHECKPOINT * (share.checkpoint is not None)
        flags += _SUSPECT * share.suspect
        nodes = len(self.codecs)
        digest = sum(held << (age * nodes) for age, held in enumerate(share.digest))
        parts = [bytes((flags, len(share.records))), digest.to_bytes(self.digest_bytes, "little")]
        if share.checkpoint is not None:
            parts.append(self.belief.encode(share.checkpoint))
        for source, age, record in share.records:
            parts.append(bytes((source, age)) + record)
        return b"".join(parts)

    def decode(self, body: bytes) -> LabelledShare:
        """The share that `encode` wrote.

        Raises:
            Rejected: `labelled-length`, `labelled-label`, or what is wrong with a checkpoint.
        """
        start = _HEAD_BYTES + self.digest_bytes
        if len(body) < start:
            raise Rejected("labelled-length")
        flags, count = body[0], body[1]
        digest = int.from_bytes(body[_HEAD_BYTES:start], "little")
        checkpoint = None
        if flags & _CHECKPOINT:
            checkpoint = self.belief.decode(body[start : start + self.belief.size])
            start += self.belief.size
        nodes = len(self.codecs)
        everybody = (1 << nodes) - 1
        return LabelledShare(
            bool(flags & _NEED),
            checkpoint,
            tuple(digest >> (age * nodes) & everybody for age in range(self.digest_steps)),
            self._records(body[start:], count),
            bool(flags & _SUSPECT),
        )

    def _records(self, data: bytes, count: int) -> tuple[Labelled, ...]:
        records: list[Labelled] = []
        for _ in range(count):
            if len(data) < _LABEL_BYTES:
                raise Rejected("labelled-length")
            source, age = data[0], data[1]
            codec = self.codecs[source] if source < len(self.codecs) else None
            if codec is None or age >= self.window_steps:
                raise Rejected("labelled-label")
            end = _LABEL_BYTES + codec.length(data[_LABEL_BYTES:])
            if len(data) < end:
                raise Rejected("labelled-length")
            records.append(Labelled(source, age, data[_LABEL_BYTES:end]))
            data = data[end:]
        return tuple(records)


def check_limit(limit_bytes: int, nodes: int, digest_steps: int, content_bytes: int) -> None:
    """Refuse shares of at most `limit_bytes` that do not hold a content of that length.

    Raises:
        ValueError: saying by how much they are too short.
    """
    head_bytes = _HEAD_BYTES + _digest_bytes(nodes, digest_steps)
    missing = least_limit(nodes, digest_steps, content_bytes) - limit_bytes
    if missing > 0:
        raise ValueError(
            f"labelled shares of at most {limit_bytes} bytes must hold a checkpoint or a record of "
            f"{content_bytes} bytes beside {head_bytes} bytes of head and digest; raise "
            f"--payload-bytes by {missing + missing % 2} or more (254 at most), or lower "
            "--digest-steps"
        )


def least_limit(nodes: int, digest_steps: int, content_bytes: int) -> int:
    """Return the length of a share that holds a content of that length."""
    return _HEAD_BYTES + _digest_bytes(nodes, digest_steps) + content_bytes


def _digest_bytes(nodes: int, digest_steps: int) -> int:
    return -(-nodes * digest_steps // 8)
