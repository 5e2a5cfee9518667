"""Knowledge of a node about the records of its neighbours."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from concord.nodes.rules.labelled.record_choice import RecordChoice
from concord.nodes.rules.labelled.record_sets import (
    RecordSets,
    from_digest,
    no_records,
    one_step_on,
)


class NeighbourRecords(NamedTuple):
    """Knowledge of J neighbours.

    Attributes:
        known: (J, K, W, B), what each was told and has confirmed (`RecordChoice`).
        reports: (2,), the records that digests told of, and those of them that were lacking.
        heard: step at which a share of each came last.
        share_cycles: cycle of the last share of each, -1 for never.
        sent: the records of the share composed in the open group; None if there was none.
    """

    known: RecordSets
    reports: np.ndarray
    heard: tuple[int, ...]
    share_cycles: tuple[int, ...]
    sent: RecordSets | None = None

    def step_begun(self) -> "NeighbourRecords":
        """Return the same a step later."""
        return self._replace(known=one_step_on(self.known))

    def heard_from(self, place: int, step: int, cycle: int) -> "NeighbourRecords":
        """Note that a share of the neighbour at a place has come."""
        heard, cycles = list(self.heard), list(self.share_cycles)
        heard[place], cycles[place] = step, cycle
        return self._replace(heard=tuple(heard), share_cycles=tuple(cycles))

    def forgotten(self, place: int, last: int | None = None) -> "NeighbourRecords":
        """Forget what a neighbour knows of the places up to `last` of the window."""
        known = self.known.copy()
        known[place, :, :last] = 0
        return self._replace(known=known)

    def reported(
        self, choice: RecordChoice, place: int, digest: Sequence[int]
    ) -> "NeighbourRecords":
        """Take over the digest of a neighbour, one set of sources per age, as bits."""
        known = self.known.copy()
        known[place], told = choice.reported(known[place], from_digest(digest, known.shape[-1]))
        return self._replace(known=known, reports=self.reports + told)

    def told(
        self,
        choice: RecordChoice,
        came: Iterable[tuple[int, RecordSets]],
        overhearing: Sequence[Sequence[int]],
    ) -> "NeighbourRecords":
        """End a group: neighbours were told of the records sent, and of those that came.

        Args:
            came: place of a neighbour, and the records (W, B) that it sent.
            overhearing: for each neighbour, the places of the others that hear it too.
        """
        told = np.zeros_like(self.known[:, 0])
        shown = np.zeros_like(told)
        if self.sent is not None:
            told |= self.sent
        for place, records in came:
            told[list(overhearing[place])] |= records
            shown[place] |= records
        known = choice.confirmed(choice.told(self.known, told), shown)
        return self._replace(known=known, sent=None)

    def ages(self, cycle: int) -> np.ndarray:
        """Cycles before `cycle` since each neighbour's last share was sent."""
        last = np.array(self.share_cycles, dtype=int)
        return np.where(last < 0, -1, cycle - 1 - last)


def nothing_known(neighbours: int, choice: RecordChoice, step: int) -> NeighbourRecords:
    """Return the start of a node at a step, with so many neighbours."""
    return NeighbourRecords(
        no_records((neighbours, choice.levels), choice.window_steps, choice.nodes),
        np.zeros(2, dtype=np.int64),
        (step,) * neighbours,
        (-1,) * neighbours,
    )


def overhearing(neighbours: Sequence[Sequence[int]], node: int) -> tuple[tuple[int, ...], ...]:
    """For each neighbour of a node, the places of its other neighbours that hear it too."""
    near = neighbours[node]
    return tuple(
        tuple(place for place, other in enumerate(near) if sender in neighbours[other])
        for sender in near
    )
