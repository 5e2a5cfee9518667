"""Share of the rule `labelled`: labelled records, at times a checkpoint, a digest.

    flags u8 (1: I need a checkpoint, 2: here is one, 4: I am lost) | number of labelled records u8
    | digest | mask | checkpoint: mean, upper covariance, float32
    | readings of masked records | labelled records: source u8, age u8, readings

The step is not written: a share belongs to the cycle that its frame says, and so to its step. The
digest has a bit for each of the N sources: a record of it is held. Each such source has another bit
for each of the digest's steps, the newest first: the record of this step is held. The mask has one
bit for each held record of the digest, by age and source: this record follows. So a record of the
digest's steps needs no label, and takes a bit where a label takes two bytes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import NamedTuple, TypeVar

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import Rejected
from concord.nodes.rules.labelled.record_codec import RecordForm
from concord.nodes.rules.labelled.record_sets import RecordSets
from concord.nodes.vector_codec import BeliefCodec

MAX_SOURCES = 256
MAX_WINDOW_STEPS = 255
_NEED, _CHECKPOINT, _SUSPECT = 1, 2, 4
_HEAD_BYTES = 2
_LABEL_BYTES = 2
_MAX_RECORDS = 255
# Of a frame of FlexRay.
_MOST_PAYLOAD_BYTES = 254


_Count = TypeVar("_Count", int, np.ndarray)


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

    `codecs` has one entry per source, None for a node without a sensor. A share has `limit_bytes`
    at most; one with a checkpoint may be longer, up to `checkpoint_limit_bytes`.

    Raises:
        ValueError: a share does not hold a checkpoint, or not every record.
    """

    codecs: Sequence[RecordForm | None]
    belief: BeliefCodec
    window_steps: int
    digest_steps: int
    limit_bytes: int
    checkpoint_limit_bytes: int = 0

    def __post_init__(self) -> None:
        record = _LABEL_BYTES + max((codec.size_max for codec in self.codecs if codec), default=0)
        for limit, content in ((self.limit_bytes, record), (self.longest_bytes, self.belief.size)):
            check_limit(limit, len(self.codecs), self.digest_steps, content)

    @property
    def longest_bytes(self) -> int:
        """Length of the longest share."""
        return max(self.limit_bytes, self.checkpoint_limit_bytes)

    def limits(self, with_checkpoint: np.ndarray) -> np.ndarray:
        """Most bytes (...) of shares."""
        return np.where(with_checkpoint, self.longest_bytes, self.limit_bytes)

    def room(self, held: RecordSets, with_checkpoint: np.ndarray) -> np.ndarray:
        """Bytes (...) left for records in shares of nodes that hold (..., W, B) of them."""
        last = held[..., self.window_steps - self.digest_steps :, :]
        mask_bytes = -(-np.bitwise_count(last).sum(axis=(-1, -2), dtype=np.int64) // 8)
        sources = np.bitwise_count(np.bitwise_or.reduce(last, axis=-2)).sum(axis=-1, dtype=np.int64)
        taken = _HEAD_BYTES + _digest_bytes(len(self.codecs), self.digest_steps, sources)
        taken += mask_bytes
        content = np.where(with_checkpoint, self.belief.size, 0)
        return self.limits(with_checkpoint) - taken - content

    def costs(self, lengths: np.ndarray) -> np.ndarray:
        """Bytes that records of those lengths (..., W, N) take in a share."""
        costs = lengths.copy()
        costs[..., : self.window_steps - self.digest_steps, :] += _LABEL_BYTES
        return costs

    def encode(self, share: LabelledShare) -> bytes:
        """The bytes of a share with at most 255 labelled records."""
        flags = _NEED * share.needs + _CHECKPOINT * (share.checkpoint is not None)
        flags += _SUSPECT * share.suspect
        nodes = len(self.codecs)
        digest = sum(held << (age * nodes) for age, held in enumerate(share.digest))
        masked: dict[int, bytes] = {}
        labelled: list[bytes] = []
        for source, age, record in share.records:
            bit = age * nodes + source
            if digest >> bit & 1 and bit not in masked:
                masked[bit] = record
            else:
                labelled.append(bytes((source, age)) + record)
        assert len(labelled) <= _MAX_RECORDS, "a record takes at least four bytes of 254"
        mask = sum((bit in masked) << place for place, bit in enumerate(_bits(digest)))
        parts = [
            bytes((flags, len(labelled))),
            _packed_digest(share.digest, nodes),
            mask.to_bytes(_mask_bytes(digest), "little"),
        ]
        if share.checkpoint is not None:
            parts.append(self.belief.encode(share.checkpoint))
        return b"".join((*parts, *(masked[bit] for bit in sorted(masked)), *labelled))

    def decode(self, body: bytes) -> LabelledShare:
        """The share that `encode` wrote.

        Raises:
            Rejected: `labelled-length`, `labelled-label`, `labelled-mask`, or what is wrong with a
                checkpoint.
        """
        if len(body) < _HEAD_BYTES:
            raise Rejected("labelled-length")
        flags, count = body[0], body[1]
        nodes = len(self.codecs)
        ages, start = self._read_digest(body)
        digest = sum(held << (age * nodes) for age, held in enumerate(ages))
        labels = self._masked(digest, body[start : start + _mask_bytes(digest)])
        start += _mask_bytes(digest)
        checkpoint = None
        if flags & _CHECKPOINT:
            checkpoint = self.belief.decode(body[start : start + self.belief.size])
            start += self.belief.size
        return LabelledShare(
            bool(flags & _NEED),
            checkpoint,
            ages,
            self._records(body[start:], labels, count),
            bool(flags & _SUSPECT),
        )

    def _read_digest(self, body: bytes) -> tuple[tuple[int, ...], int]:
        """Return the digest of a share, and where the mask begins."""
        nodes, steps = len(self.codecs), self.digest_steps
        data = int.from_bytes(body[_HEAD_BYTES:], "little")
        sources = _bits(data & ((1 << nodes) - 1)) if steps else []
        end = _HEAD_BYTES + int(_digest_bytes(nodes, steps, len(sources)))
        if len(body) < end:
            raise Rejected("labelled-length")
        data = int.from_bytes(body[_HEAD_BYTES:end], "little") >> nodes
        ages = tuple(
            sum(
                (data >> age * len(sources) + place & 1) << one for place, one in enumerate(sources)
            )
            for age in range(steps)
        )
        if _packed_digest(ages, nodes) != body[_HEAD_BYTES:end]:
            raise Rejected("labelled-mask")
        return ages, end

    def _masked(self, digest: int, data: bytes) -> list[tuple[int, int]]:
        """The (source, age) of the records that a mask says."""
        if len(data) < _mask_bytes(digest):
            raise Rejected("labelled-length")
        mask, bits = int.from_bytes(data, "little"), _bits(digest)
        if mask >> len(bits):
            raise Rejected("labelled-mask")
        chosen = (bit for place, bit in enumerate(bits) if mask >> place & 1)
        return [(bit % len(self.codecs), bit // len(self.codecs)) for bit in chosen]

    def _records(
        self, data: bytes, labels: Sequence[tuple[int, int]], count: int
    ) -> tuple[Labelled, ...]:
        """The records of these labels, and so many that bring a label of their own."""
        records: list[Labelled] = []
        for place in range(len(labels) + count):
            if place < len(labels):
                source, age = labels[place]
            elif len(data) < _LABEL_BYTES:
                raise Rejected("labelled-length")
            else:
                source, age, data = data[0], data[1], data[_LABEL_BYTES:]
            codec = self.codecs[source] if source < len(self.codecs) else None
            if codec is None or age >= self.window_steps:
                raise Rejected("labelled-label")
            end = codec.length(data)
            if len(data) < end:
                raise Rejected("labelled-length")
            records.append(Labelled(source, age, data[:end]))
            data = data[end:]
        return tuple(records)


def check_limit(limit_bytes: int, nodes: int, digest_steps: int, content_bytes: int) -> None:
    """Refuse shares of at most `limit_bytes` that do not hold a content of that length.

    Raises:
        ValueError: saying by how much they are too short.
    """
    head_bytes = least_limit(nodes, digest_steps, 0)
    missing = head_bytes + content_bytes - limit_bytes
    if missing <= 0:
        return
    missing += missing % 2
    cure = f"raise --payload-bytes by {missing} or more (254 at most), or lower --digest-steps"
    if limit_bytes + missing > _MOST_PAYLOAD_BYTES:
        cure = "use --record-number int12, or another rule such as ci or hcmci"
    raise ValueError(
        f"labelled shares of at most {limit_bytes} bytes must hold a checkpoint or a record of "
        f"{content_bytes} bytes beside {head_bytes} bytes of head, digest and mask; {cure}"
    )


def least_limit(nodes: int, digest_steps: int, content_bytes: int) -> int:
    """Return the length of a share that holds a content of that length, whatever its mask."""
    mask_bytes = -(-nodes * digest_steps // 8)
    return _HEAD_BYTES + _digest_bytes(nodes, digest_steps, nodes) + mask_bytes + content_bytes


def labelled_bytes(record_bytes: int) -> int:
    """Return the bytes that a record takes with its label."""
    return _LABEL_BYTES + record_bytes


def _digest_bytes(nodes: int, steps: int, sources: _Count) -> _Count:
    """Length of a digest that holds records of so many sources."""
    return -(-(nodes + steps * sources) // 8) if steps else 0 * sources


def _packed_digest(digest: Sequence[int], nodes: int) -> bytes:
    if not digest:
        return b""
    sources = _bits(reduce(or_, digest))
    bits = sum(1 << source for source in sources)
    for age, held in enumerate(digest):
        for place, source in enumerate(sources):
            bits |= (held >> source & 1) << nodes + age * len(sources) + place
    return bits.to_bytes(_digest_bytes(nodes, len(digest), len(sources)), "little")


def _bits(digest: int) -> list[int]:
    """The places of the bits that are set, ascending."""
    return [bit for bit in range(digest.bit_length()) if digest >> bit & 1]


def _mask_bytes(digest: int) -> int:
    return -(-digest.bit_count() // 8)
