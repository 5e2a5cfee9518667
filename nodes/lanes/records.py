"""`concord.nodes.rules.record_sets` in arrays: sets of records (..., W, B), bytes of one bit per
source.

Place W - 1 is the newest step, so places before the first step of a run are empty; source s is bit
s mod 8 of byte s // 8. The content of a set at a place is a row of bytes, and unions are bitwise.
"""

import numpy as np

RecordSets = np.ndarray


def no_records(shape: tuple[int, ...], window_steps: int, nodes: int) -> RecordSets:
    """Empty sets of this shape."""
    return np.zeros((*shape, window_steps, -(-nodes // 8)), dtype=np.uint8)


def packed(flags: np.ndarray) -> RecordSets:
    """The sets (..., W, B) of flags (..., W, N)."""
    return np.packbits(flags, axis=-1, bitorder="little")


def flags_of(sets: RecordSets, nodes: int) -> np.ndarray:
    """Whether each record is in: (..., W, N) bool."""
    return np.unpackbits(sets, axis=-1, count=nodes, bitorder="little").view(bool)


def one_step_on(sets: RecordSets) -> RecordSets:
    """The same when a step begins: the oldest place is forgotten, the newest is empty."""
    moved = np.zeros_like(sets)
    moved[..., :-1, :] = sets[..., 1:, :]
    return moved


def need(absent: RecordSets, urgencies: np.ndarray) -> np.ndarray:
    """Numbers of records (...), each times the urgency (W,) of its place: integers."""
    counts: np.ndarray = np.bitwise_count(absent)
    counts = counts.reshape(*absent.shape[:-2], -1)
    # Whole numbers far below 2^53 are exact as floats, of which products are fast.
    weights = np.repeat(urgencies, absent.shape[-1]).astype(float)
    return (counts @ weights).astype(np.int64)


def first_places(sets: RecordSets) -> np.ndarray:
    """The oldest place in which there is a record, (...); W for an empty set."""
    there = np.asarray(sets.any(axis=-1))
    return np.where(there.any(axis=-1), there.argmax(axis=-1), sets.shape[-2])


def first_that_fit(
    wanted: tuple[RecordSets, ...], costs: np.ndarray, room: np.ndarray
) -> tuple[RecordSets, np.ndarray, np.ndarray]:
    """Choose a share's records from disjoint sets (L, W, B), set after set.

    The order is newest first, sources ascending, until a record does not fit.

    Args:
        costs: bytes of each record (L, W, N).
        room: bytes that records may take (L,).

    Returns:
        What it takes (L, W, B); how many bytes and how many records (L,).
    """
    queue = flags_of(np.stack(wanted, axis=1)[:, :, ::-1], costs.shape[-1])
    length = np.where(queue, costs[:, None, ::-1], 0).reshape(len(queue), -1)
    if (length.sum(axis=1) > room).any():
        fits = length.cumsum(axis=1) <= room[:, None]
        queue = queue & fits.reshape(queue.shape)
        length = np.where(fits, length, 0)
    chosen = packed(np.asarray(queue.any(axis=1))[:, ::-1])
    return chosen, length.sum(axis=1), queue.sum(axis=(1, 2, 3))


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
