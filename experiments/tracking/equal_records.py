"""Whether nodes with equal records have equal tracks, bit for bit."""

from collections import Counter
from collections.abc import Sequence

import msgspec

from concord.filters.tracking.tracker import Tracked


class PairsCompared(msgspec.Struct, frozen=True):
    """Pairs of nodes with equal records up to a step, over all steps, and those that differ."""

    pairs: int
    different: int


def bits_of(tracked: Tracked) -> bytes:
    """Return all numbers of the tracks as bytes."""
    tracks = tracked.tracks
    parts = (*tracks.belief, tracks.existence, tracks.identity, tracks.confirmed)
    return b"".join(part.tobytes() for part in parts)


def pairs_with_equal_records(evidence: Sequence[bytes], bits: Sequence[bytes]) -> PairsCompared:
    """Compare the nodes of a step, by what each has used and the bits of its tracks."""
    pairs = _pairs(Counter(evidence))
    return PairsCompared(pairs, pairs - _pairs(Counter(zip(evidence, bits, strict=True))))


def pairs_alike(bits: Sequence[bytes]) -> float:
    """Part of the pairs of nodes with equal tracks, bit for bit; 1 for a single node."""
    nodes = len(bits)
    return 2 * _pairs(Counter(bits)) / (nodes * (nodes - 1)) if nodes > 1 else 1.0


def _pairs(groups: Counter) -> int:
    return sum(size * (size - 1) // 2 for size in groups.values())
