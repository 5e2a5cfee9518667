"""Knowledge of all nodes about the records of their neighbours.

This is `concord.nodes.rules.labelled.neighbour_records` in arrays.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from concord.nodes.lanes.labelled_shares import Came, Shared
from concord.nodes.lanes.links import Links, Padded, neighbourhoods, overhearing
from concord.nodes.rules.labelled.record_choice import RecordChoice
from concord.nodes.rules.labelled.record_sets import RecordSets, joined, no_records, one_step_on


class BatchedNeighbourRecords(NamedTuple):
    """Knowledge of each link's sender, as its receiver has it.

    known: (R, E, K, W, B), what the sender was told and has confirmed. reports: (R, N, 2). heard:
    steps (R, E). share_cycles: (R, E).
    """

    known: RecordSets
    reports: np.ndarray
    heard: np.ndarray
    share_cycles: np.ndarray

    def step_begun(self) -> "BatchedNeighbourRecords":
        """Return the same a step later."""
        return self._replace(known=one_step_on(self.known))

    def heard_over(self, came: Came, step: int, cycle: int) -> "BatchedNeighbourRecords":
        """Note that shares have come."""
        heard, share_cycles = self.heard.copy(), self.share_cycles.copy()
        heard[came.runs, came.links] = step
        share_cycles[came.runs, came.links] = cycle
        return self._replace(heard=heard, share_cycles=share_cycles)

    def ages(self, cycle: int) -> np.ndarray:
        """Cycles before `cycle` since the last share over each link was sent, (R, E)."""
        last = self.share_cycles
        return np.where(last < 0, -1, cycle - 1 - last)


@dataclass(frozen=True)
class Neighbourhoods:
    """The neighbours of all nodes, by links, and how records are chosen for them."""

    links: Links
    choice: RecordChoice

    def start(self, runs: int, step: int) -> BatchedNeighbourRecords:
        """Return the knowledge before anything was heard, at a step."""
        links, nodes = len(self.links.sender), self.links.nodes
        # A node without neighbours has no link, and yet the arrays have a place.
        shape = (runs, max(links, 1), self.choice.levels)
        return BatchedNeighbourRecords(
            no_records(shape, self.choice.window_steps, nodes),
            np.zeros((runs, nodes, 2), dtype=np.int64),
            np.full((runs, links), step),
            np.full((runs, links), -1),
        )

    def doubts(
        self, near: BatchedNeighbourRecords, held: RecordSets, runs: np.ndarray, nodes: np.ndarray
    ) -> RecordSets:
        """Return the records of `held` (R, N, W, B) that these nodes (L,) hold and each neighbour
        may lack, by how often it was told: (L, J, K, W, B).

        Places without a neighbour are empty.
        """
        theirs = near.known[runs[:, None], self.near.links[nodes]]
        doubts = self.choice.doubts(held[runs, nodes], theirs)
        return np.where(self.near.real[nodes][..., None, None, None], doubts, np.uint8(0))

    def reported(
        self, near: BatchedNeighbourRecords, held: RecordSets, came: Came
    ) -> BatchedNeighbourRecords:
        """Take over the digests of senders that hold `held` (R, N, W, B)."""
        runs, links, known, reports = came.runs, came.links, near.known.copy(), near.reports.copy()
        digest = held[runs, self.links.sender[links], -self.choice.digest_steps :]
        known[runs, links], told = self.choice.reported(known[runs, links], digest)
        np.add.at(reports, (runs, self.links.receiver[links]), told)
        return near._replace(known=known, reports=reports)

    def told(
        self, near: BatchedNeighbourRecords, shares: Shared, came: Came
    ) -> BatchedNeighbourRecords:
        """Note who was told of records: each hearer knows that the other hearers heard them too."""
        runs, links = came.runs, came.links
        told = shares.records[came.lanes]
        count = near.known.shape[1]
        # A sender takes it that all neighbours hear it.
        lane, place = np.nonzero(self.near.real[shares.nodes])
        own = shares.runs[lane] * count + self.near.links[shares.nodes][lane, place]
        share, place = np.nonzero(self._overheard.real[links])
        also = runs[share] * count + self._overheard.links[links][share, place]
        known = near.known.reshape(-1, *near.known.shape[2:])
        none = np.zeros_like(known[:, 0])
        more, _, _ = joined(
            none, np.concatenate((own, also)), np.concatenate((shares.records[lane], told[share]))
        )
        shown, _, _ = joined(none, runs * count + links, told)
        known = self.choice.confirmed(self.choice.told(known, more), shown)
        return near._replace(known=known.reshape(near.known.shape))

    @cached_property
    def near(self) -> Padded:
        """The links of each node."""
        return neighbourhoods(self.links)

    @cached_property
    def _overheard(self) -> Padded:
        return overhearing(self.links)
