"""Which records somebody holds: per step the sources as the bits of an integer."""

from collections.abc import Iterator, Mapping, Sequence

RecordSet = Mapping[int, int]


def union(one: RecordSet, other: RecordSet) -> RecordSet:
    """What either of them has."""
    if not other:
        return one
    joined = dict(one)
    for step, sources in other.items():
        joined[step] = joined.get(step, 0) | sources
    return joined


def after(records: RecordSet, step: int) -> RecordSet:
    """What is of later steps."""
    return {t: sources for t, sources in records.items() if t > step}


def lacked(held: RecordSet, known: Sequence[RecordSet]) -> dict[int, int]:
    """What is held and somebody lacks; steps of which nothing is lacked are left out."""
    missing: dict[int, int] = {}
    for theirs in known:
        for step, mine in held.items():
            absent = mine & ~theirs.get(step, 0)
            if absent:
                missing[step] = missing.get(step, 0) | absent
    return missing


def need(held: RecordSet, known: Sequence[RecordSet], urgencies: Mapping[int, int]) -> int:
    """How often something is held that somebody lacks, each times the urgency of its step."""
    total = 0
    for theirs in known:
        for step, mine in held.items():
            absent = mine & ~theirs.get(step, 0)
            if absent:
                total += urgencies[step] * absent.bit_count()
    return total


def sources_of(sources: int) -> Iterator[int]:
    """The sources of a step, ascending."""
    while sources:
        lowest = sources & -sources
        yield lowest.bit_length() - 1
        sources ^= lowest
