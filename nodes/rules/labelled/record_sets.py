"""Sets of records that nodes hold, as arrays (..., W, B): one bit per source in a row of bytes.

Place W - 1 is the newest step of the window, so places before the first step of a run are empty.
Source s is bit s mod 8 of byte s // 8. Unions are bitwise; leading axes are free, and a node has
none.
"""

from collections.abc import Iterator, Sequence

import numpy as np

RecordSets = np.ndarray

# A record that one neighbour lacks, and what it loses of that urgency with every step of age.
URGENCY = 65536
_DISCOUNT = 0.9
# Equal needs are served in the order of silence, up to so many cycles.
SILENCE = 4096


def bids_for_records(nodes: int) -> tuple[int, int]:
    """Return the bids between which urgency is told apart: the winners of networks of several
    shapes bid for 0.15 to 2 new records of every node that one neighbour lacks."""
    of_every_node = nodes * URGENCY * SILENCE
    return 3 * of_every_node // 20, 2 * of_every_node


def urgencies(window_steps: int) -> np.ndarray:
    """Return the urgency (W,) of one lacked record of each step of a window, the oldest first."""
    ages = np.arange(window_steps)[::-1]
    return (URGENCY * _DISCOUNT**ages + 0.5).astype(np.int64)


def no_records(shape: tuple[int, ...], window_steps: int, nodes: int) -> RecordSets:
    """Empty sets of this shape."""
    return np.zeros((*shape, window_steps, -(-nodes // 8)), dtype=np.uint8)


def packed(flags: np.ndarray) -> RecordSets:
    """The sets (..., W, B) of flags (..., W, N)."""
    return np.packbits(flags, axis=-1, bitorder="little")


def flags_of(sets: RecordSets, nodes: int) -> np.ndarray:
    """Whether each record is in: (..., W, N) bool."""
    return np.unpackbits(sets, axis=-1, count=nodes, bitorder="little").view(bool)


def digest_of(sets: RecordSets, steps: int) -> tuple[int, ...]:
    """The sources in the last places of one set (W, B), the newest place first, as bits."""
    last = sets[len(sets) - steps :]
    return tuple(int.from_bytes(sources.tobytes(), "little") for sources in last[::-1])


def from_digest(digest: Sequence[int], width: int) -> RecordSets:
    """The set (D, B) that a digest tells, in rows of so many bytes."""
    data = b"".join(sources.to_bytes(width, "little") for sources in digest[::-1])
    return np.frombuffer(data, np.uint8).reshape(-1, width)


def one_step_on(sets: RecordSets) -> RecordSets:
    """The same when a step begins: the oldest place is forgotten, the newest is empty."""
    moved = np.zeros_like(sets)
    moved[..., :-1, :] = sets[..., 1:, :]
    return moved


def with_record(sets: RecordSets, place: int, source: int) -> RecordSets:
    """The same set (W, B) with one record more."""
    more = sets.copy()
    more[place, source // 8] |= 1 << source % 8
    return more


def count_by_urgency(sets: RecordSets, urgencies: np.ndarray) -> np.ndarray:
    """Numbers of records (...), each times the urgency (W,) of its place: integers."""
    counts: np.ndarray = np.bitwise_count(sets)
    counts = counts.reshape(*sets.shape[:-2], sets.shape[-2] * sets.shape[-1])
    # Whole numbers far below 2^53 are exact as floats, of which products are fast.
    weights = np.repeat(urgencies, sets.shape[-1]).astype(float)
    return (counts @ weights).astype(np.int64)


def first_places(sets: RecordSets) -> np.ndarray:
    """The oldest place in which there is a record, (...); W for an empty set."""
    there = np.asarray(sets.any(axis=-1))
    return np.where(there.any(axis=-1), there.argmax(axis=-1), sets.shape[-2])


def newest_first(records: RecordSets, nodes: int) -> Iterator[tuple[int, int]]:
    """Each (place, source) of one set (W, B): the last place first, its sources ascending."""
    for age, source in np.argwhere(flags_of(records[::-1], nodes)).tolist():
        yield len(records) - 1 - age, source


def first_that_fit(
    wanted: RecordSets, costs: np.ndarray, room: np.ndarray
) -> tuple[RecordSets, np.ndarray]:
    """Choose records from sets (..., W, B), newest first, sources ascending, until one does not
    fit.

    Args:
        costs: bytes of each record (..., W, N).
        room: bytes that records may take (...).

    Returns:
        The chosen records (..., W, B), and how many bytes they take (...).
    """
    queue = flags_of(wanted[..., ::-1, :], costs.shape[-1])
    lengths = np.where(queue, costs[..., ::-1, :], 0).reshape(*queue.shape[:-2], -1)
    if (lengths.sum(axis=-1) > room).any():
        fits = lengths.cumsum(axis=-1) <= np.asarray(room)[..., None]
        queue = queue & fits.reshape(queue.shape)
        lengths = np.where(fits, lengths, 0)
    return packed(queue)[..., ::-1, :], lengths.sum(axis=-1)


def joined(
    sets: RecordSets, index: np.ndarray, more: RecordSets
) -> tuple[RecordSets, np.ndarray, RecordSets]:
    """Sets (K, W, B) with `more` (J, W, B) added to those of `index` (J,), any number to each.

    Returns:
        The sets; the indices that were added to (I,), ascending; and what was new there (I, W, B).
    """
    if not len(index):
        return sets, index, more
    order = np.argsort(index, kind="stable")
    ordered = index[order]
    starts = np.flatnonzero(np.diff(ordered, prepend=-1))
    union = np.bitwise_or.reduceat(more[order], starts, axis=0)
    places = ordered[starts]
    before = sets[places]
    sets = sets.copy()
    sets[places] = before | union
    return sets, places, union & ~before
