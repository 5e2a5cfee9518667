"""`concord.nodes.rules.labelled.checked` at all nodes of all runs at once."""

from dataclasses import dataclass

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.filter import added
from concord.nodes.lanes.labelled import BatchedFlooding, BatchedLabelledContent
from concord.nodes.lanes.labelled_shares import Came, Shared
from concord.nodes.rules.labelled.record_sets import RecordSets
from concord.nodes.rules.labelled.self_check import ASKING, is_suspect, trusting
from concord.nodes.rules.labelled.window_smoother import smoothed_past


@dataclass(frozen=True)
class BatchedSelfChecked(BatchedFlooding):
    """`BatchedFlooding` with the check of each node's own belief."""

    def suspect(self, content: BatchedLabelledContent) -> np.ndarray:
        """Whether the records of windows do not fit the beliefs, (R, N)."""
        return is_suspect(content.windows)

    def bids(self, content: BatchedLabelledContent, nodes: np.ndarray) -> np.ndarray:
        """The bids of `BatchedFlooding`; a node that asks for help has urgent news once a step."""
        asks = _asking(content) & (content.cycle - content.sent_cycle >= self.rounds)
        return super().bids(content._replace(owed=content.owed + asks.astype(int)), nodes)

    def _chosen(
        self, content: BatchedLabelledContent, runs: np.ndarray, nodes: np.ndarray
    ) -> tuple[RecordSets, np.ndarray]:
        """Return the records and the bytes of shares; no checkpoint while a node asks for help."""
        return super()._chosen(content._replace(owed=content.owed & ~_asking(content)), runs, nodes)

    def _composed(
        self, content: BatchedLabelledContent, runs: np.ndarray, nodes: np.ndarray
    ) -> tuple[BatchedLabelledContent, Shared, np.ndarray]:
        """The shares of nodes; those that ask for help still owe their checkpoints."""
        kept = content.owed & _asking(content)
        after, shares, sound = super()._composed(
            content._replace(owed=content.owed & ~kept), runs, nodes
        )
        return after._replace(owed=after.owed | kept), shares, sound

    def _heard(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Note the neighbours' statements about themselves; help neighbours that ask."""
        after, asks = super()._heard(content, shares, came), _asking(content)
        if not asks.any():
            return after
        sender, receiver = self.links.sender[came.links], self.links.receiver[came.links]
        here = asks[came.runs, sender] & ~asks[came.runs, receiver]
        runs, links = came.runs[here], came.links[here]
        known, owed = after.near.known.copy(), after.owed.copy()
        known[runs, links, :, : self.frames.window_steps - self.frames.digest_steps] = 0
        owed[runs, receiver[here]] = True
        return after._replace(near=after.near._replace(known=known), owed=owed)

    def _with_checkpoints(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Fuse checkpoints with bases; the first replaces the base of a node that asks for help."""
        asks = _asking(content)
        receiver = self.links.receiver[came.links]
        first = np.flatnonzero(shares.with_checkpoint[came.lanes] & asks[came.runs, receiver])
        # Shares stand in order of run, receiver and sender.
        _, place = np.unique(
            came.runs[first] * self.links.nodes + receiver[first], return_index=True
        )
        first = first[place]
        if not len(first):
            return super()._with_checkpoints(content, shares, came)
        base = Gaussian(*(values.copy() for values in content.windows.base))
        lanes = came.runs[first], receiver[first]
        adopted = np.zeros(asks.shape, dtype=bool)
        adopted[lanes] = True
        for values, given in zip(base, shares.checkpoint, strict=True):
            values[lanes] = given[came.lanes[first]]
        windows = trusting(content.windows._replace(base=base), adopted)
        content = content._replace(
            kept=content.kept._replace(windows=windows),
            counters=added(content.counters, {"checkpoint-adopted": adopted}),
        )
        left = np.ones(len(came.lanes), dtype=bool)
        left[first] = False
        return super()._with_checkpoints(content, shares, Came(*(one[left] for one in came)))


def _asking(content: BatchedLabelledContent) -> np.ndarray:
    return is_suspect(content.windows, ASKING)


@dataclass(frozen=True)
class BatchedSmoothing(BatchedSelfChecked):
    """`BatchedSelfChecked` with the smoothed states of the last `smooth_steps` steps."""

    smooth_steps: int = 0

    def smoothed(self, content: BatchedLabelledContent) -> Gaussian:
        """States of 0, 1, ... steps ago given all records: mean (R, N, L, n), cov (R, N, L, n, n);
        NaN before the window's first step."""
        return smoothed_past(self.filter, content.windows, self.smooth_steps)
