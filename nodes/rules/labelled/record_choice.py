"""Choice of the records of a share, by the chance that neighbours lack them.

A sender does not know which neighbours lost its frame. It counts how often a neighbour was told of
a record, by frames of the node itself or by overheard ones, until the neighbour confirms it. Each
telling multiplies the chance that the record is lacking by the node's estimate of the loss, which
it learns from the digests. A node and the batched driver use these functions; a node has no leading
axes.

Source of the count over neighbours: the project's study of fusion under bus limits. Source of the
digests as the side information of the sender: index coding (Bar-Yossef, Birk, Jayram, Kol, IEEE
Trans. Inf. Theory 57, 2011).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from concord.nodes.rules.labelled.record_sets import (
    RecordSets,
    count_by_urgency,
    first_that_fit,
    flags_of,
    packed,
    urgencies,
)

# Chances are multiples of this, so that all drivers compare the same integers.
_CERTAIN = 1024
# Before the first digest: one of four records that were told once is lacking.
_PRIOR_LACKING, _PRIOR_TOLD = 1, 4
# Levels of knowledge where links lose frames: told once, told twice, confirmed.
_LOSSY_LEVELS = 3


@dataclass(frozen=True)
class RecordChoice:
    """How a node of a network chooses records, with or without digests.

    A record that was told to all neighbours and is not confirmed is repeated if the expected number
    of neighbours without it is `repeat_above` at least, 0 for always. Repetitions take
    `repeat_bytes` of a share at most.
    """

    nodes: int
    window_steps: int
    digest_steps: int
    repeat_above: float = 0.12
    repeat_bytes: int = 48

    @property
    def levels(self) -> int:
        """Levels K of knowledge: without digests a told record counts as confirmed."""
        return _LOSSY_LEVELS if self.digest_steps else 1

    def told(self, known: RecordSets, more: RecordSets) -> RecordSets:
        """Sets (..., K, W, B) after a telling of records (..., W, B)."""
        after = known.copy()
        for level in range(1, self.levels - 1):
            after[..., level, :, :] |= known[..., level - 1, :, :] & more
        after[..., 0, :, :] |= more
        return after

    @staticmethod
    def confirmed(known: RecordSets, more: RecordSets) -> RecordSets:
        """Sets (..., K, W, B) after a neighbour itself has shown that it holds `more`."""
        return known | more[..., None, :, :]

    def reported(self, known: RecordSets, digest: RecordSets) -> tuple[RecordSets, np.ndarray]:
        """Take over digests (..., D, B) of neighbours of whom sets (..., K, W, B) are known.

        Returns:
            The sets, and reports (..., 2): how many records that were told once the digest is
            about, and how many of them are lacking.
        """
        last = known[..., self.window_steps - self.digest_steps :, :]
        once = last[..., 0, :, :] & ~last[..., 1, :, :]
        counts = (np.bitwise_count(some).sum(axis=(-1, -2)) for some in (once, once & ~digest))
        after = known.copy()
        after[..., self.window_steps - self.digest_steps :, :] = digest[..., None, :, :]
        return after, np.stack(tuple(counts), axis=-1).astype(np.int64)

    def doubts(self, held: RecordSets, known: RecordSets) -> RecordSets:
        """Return the held records (..., J, K, W, B) that each neighbour may lack, by how often it
        was told of them; a neighbour's sets are (..., J, K, W, B).

        A record that was told is doubtful only while digests are about it.
        """
        within = np.concatenate(
            (np.full_like(known[..., :1, :, :], 255), known[..., :-1, :, :]), -3
        )
        doubts = held[..., None, None, :, :] & within & ~known
        doubts[..., 1:, : self.window_steps - self.digest_steps, :] = 0
        return doubts

    def need(self, doubts: RecordSets) -> np.ndarray:
        """Return the number (...) of pairs of a record and a neighbour that was never told of it.

        Each pair counts as its urgency by age (`record_sets.URGENCY`): integers. Doubts do not
        count: with them nearly all nodes ask at any time, and slots go to repetitions.
        """
        return count_by_urgency(doubts[..., 0, :, :], self._urgencies).sum(axis=-1)

    def chosen(
        self, doubts: RecordSets, reports: np.ndarray, costs: np.ndarray, room: np.ndarray
    ) -> tuple[RecordSets, np.ndarray]:
        """Return the records (..., W, B) of shares, and how many bytes they take (...).

        Records that some neighbour was never told of come first, repetitions then; of each kind the
        newest first, sources ascending, while they fit.

        Args:
            doubts: (..., J, K, W, B), of `doubts`.
            reports: (..., 2), all that digests have told.
            costs: bytes of each record (..., W, N).
            room: bytes that records may take (...).
        """
        missing = np.bitwise_or.reduce(doubts[..., 0, :, :], axis=-3)
        records, taken = first_that_fit(missing, costs, room)
        if self.levels == 1:
            return records, taken
        flags = flags_of(doubts[..., 1:, :, :], self.nodes)
        lack = np.zeros(costs.shape, dtype=np.int64)
        for level in range(self.levels - 1):
            chance = self._chances(reports)[..., level + 1, None, None]
            lack += flags[..., level, :, :].sum(axis=-3) * chance
        least = max(1, round(self.repeat_above * _CERTAIN))
        left = np.minimum(room - taken, self.repeat_bytes)
        again, more = first_that_fit(packed(lack >= least) & ~missing, costs, left)
        return records | again, taken + more

    def _chances(self, reports: np.ndarray) -> np.ndarray:
        """Return the chances (..., K) that a record is lacking, by how often it was told: in parts
        of `_CERTAIN`, never 0."""
        told, lacking = reports[..., 0], reports[..., 1]
        loss = (lacking + _PRIOR_LACKING) / (told + _PRIOR_TOLD)
        powers = np.stack([np.ones_like(loss), loss, loss * loss][: self.levels], axis=-1)
        return np.maximum(1, np.rint(_CERTAIN * powers)).astype(np.int64)

    @cached_property
    def _urgencies(self) -> np.ndarray:
        return urgencies(self.window_steps)
