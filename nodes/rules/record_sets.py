"""Sets of records that a node holds: one integer, a bit per (place, source) of the window.

Bit `place * nodes + source` is the record that `source` took at the step `place` steps after the
window's first. When the window moves on, a shift by `nodes` bits forgets its first step.
"""

from collections.abc import Iterator, Sequence

RecordSet = int

# A record that one neighbour lacks, and what it loses of that urgency with every step of age.
URGENCY = 65536
_DISCOUNT = 0.9
# Equal needs are served in the order of silence, up to so many cycles.
SILENCE = 4096


def bids_for_records(nodes: int) -> tuple[int, int]:
    """Return the bids between which urgency is told apart: from one new record that one neighbour
    lacks to three of every node."""
    return URGENCY * SILENCE, 3 * nodes * URGENCY * SILENCE


def record_bit(place: int, source: int, nodes: int) -> RecordSet:
    """The set of this one record."""
    return 1 << place * nodes + source


def sources_at(records: RecordSet, place: int, nodes: int) -> int:
    """The sources of which there is a record of this step, as bits."""
    return records >> place * nodes & (1 << nodes) - 1


def with_sources(records: RecordSet, place: int, sources: int, nodes: int) -> RecordSet:
    """With these sources at this step and no others."""
    return records ^ (sources_at(records, place, nodes) ^ sources) << place * nodes


def lacked(held: RecordSet, known: Sequence[RecordSet]) -> RecordSet:
    """Return the held records that at least one neighbour lacks."""
    missing = 0
    for theirs in known:
        missing |= held & ~theirs
    return missing


def need(held: RecordSet, known: Sequence[RecordSet], urgencies: Sequence[int], nodes: int) -> int:
    """Count the held records that a neighbour lacks, each times the urgency of its place."""
    total = 0
    for theirs in known:
        absent = held & ~theirs
        while absent:
            place = (absent.bit_length() - 1) // nodes
            newest = absent >> place * nodes
            total += urgencies[place] * newest.bit_count()
            absent ^= newest << place * nodes
    return total


def urgencies(window_steps: int) -> tuple[int, ...]:
    """Return the urgency of one lacked record of each step of a window, the oldest first."""
    ages = reversed(range(window_steps))
    return tuple(int(URGENCY * _DISCOUNT**age + 0.5) for age in ages)


def newest_first(records: RecordSet, nodes: int) -> Iterator[tuple[int, int]]:
    """Each (place, source): the last place first, its sources ascending."""
    while records:
        place = (records.bit_length() - 1) // nodes
        sources = records >> place * nodes
        records ^= sources << place * nodes
        while sources:
            lowest = sources & -sources
            yield place, lowest.bit_length() - 1
            sources ^= lowest
