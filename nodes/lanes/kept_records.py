"""Records that the nodes of all runs keep: `concord.nodes.rules.labelled.kept_records` in arrays.

All nodes begin at the same step here, so windows have the same steps everywhere, and all copies of
a record are alike.
"""

from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.filter import Counters, added
from concord.nodes.lanes.labelled_shares import Came, Shared
from concord.nodes.lanes.links import Links
from concord.nodes.rules.labelled.record_sets import (
    RecordSets,
    first_places,
    flags_of,
    joined,
    no_records,
    one_step_on,
    packed,
)
from concord.nodes.rules.labelled.window_filter import (
    WindowFilter,
    Windows,
    fuse_base,
    one_place_on,
    steps_late,
)


class BatchedKeptRecords(NamedTuple):
    """Windows of all nodes, and the records in them.

    held: (R, N, W, B). lengths: bytes of each record (R, W, N). waiting: readings and lengths of
    records to be delivered.
    """

    windows: Windows
    held: RecordSets
    lengths: np.ndarray
    waiting: tuple[tuple[np.ndarray, np.ndarray], ...]

    @property
    def flags(self) -> np.ndarray:
        """Whether a node holds each record, (R, N, W, N)."""
        return flags_of(self.held, self.held.shape[1])

    def step_begun(
        self,
        filter: WindowFilter,
        control: np.ndarray | None,
        written: np.ndarray,
        lengths: np.ndarray,
    ) -> "BatchedKeptRecords":
        """Return them a step later, with the records that sensors deliver in it.

        `written` (R, N, r, d) are the readings as records say them, in as many bytes (R, N).
        """
        newest, nodes = self.lengths.shape[1] - 1, self.held.shape[1]
        oldest = flags_of(self.held[:, :, :1], nodes)[:, :, 0]
        windows = filter.opened(self.windows, control, oldest)
        held, window_lengths = one_step_on(self.held), one_place_on(self.lengths, 1)
        taken, right = (*self.waiting, (written, lengths)), windows.right
        late_steps = _late_steps(filter, nodes)
        for late in sorted(set(late_steps.tolist())):
            place, (values, sizes) = newest - late, taken[-1 - late]
            come = (sizes > 0) & (late_steps == late)
            held[:, :, place] |= packed(np.eye(nodes, dtype=bool) & come[..., None])
            window_lengths[:, place] += np.where(come, sizes, 0)
            new = np.where(come[..., None, None], values, np.nan)[:, None]
            windows = filter.with_readings(windows, np.array([place]), new)
            right = np.where(come, np.minimum(right, place), right)
        windows = windows._replace(right=right)
        return BatchedKeptRecords(windows, held, window_lengths, taken[1:])

    def received(self, links: Links, shares: Shared, came: Came) -> "BatchedKeptRecords":
        """Return them with the records of shares that came."""
        nodes = self.held.shape[1]
        held, places, new = joined(
            self.held.reshape(-1, *self.held.shape[2:]),
            came.runs * nodes + links.receiver[came.links],
            shares.records[came.lanes],
        )
        right = self.windows.right.flatten()
        right[places] = np.minimum(right[places], first_places(new))
        windows = self.windows._replace(right=right.reshape(self.windows.right.shape))
        return self._replace(windows=windows, held=held.reshape(self.held.shape))

    def fused(
        self, filter: WindowFilter, links: Links, shares: Shared, came: Came
    ) -> tuple["BatchedKeptRecords", Counters]:
        """Return them with bases fused with those that came, sender by sender, and what became of
        these."""
        base = Gaussian(*(values.copy() for values in self.windows.base))
        right, counters = self.windows.right.copy(), {}
        here = shares.with_checkpoint[came.lanes]
        turns = came.links - links.offsets[links.receiver[came.links]]
        for turn in np.unique(turns[here]):
            some = here & (turns == turn)
            lanes = (came.runs[some], links.receiver[came.links[some]])
            before = Gaussian(*(values[lanes] for values in base))
            other = Gaussian(*(values[came.lanes[some]] for values in shares.checkpoint))
            fused, sound, better = fuse_base(filter, before, other)
            into = tuple(one[better] for one in lanes)
            base.mean[into], base.cov[into] = fused.mean[better], fused.cov[better]
            right[into] = 0
            for name, some in (("failed", ~sound), ("known", sound & ~better), ("fused", better)):
                count = np.zeros(right.shape, dtype=np.int64)
                count[lanes] = some
                counters = added(counters, {f"checkpoint-{name}": count})
        return self._replace(windows=self.windows._replace(base=base, right=right)), counters


def nothing_kept_in_batch(
    filter: WindowFilter, prior: Gaussian, first_step: int, width: int
) -> BatchedKeptRecords:
    """Return windows of so many steps on priors (R, N, n), without records."""
    runs, nodes = prior.mean.shape[:2]
    none = np.full((runs, nodes, *filter.sensors.delivered), np.nan)
    return BatchedKeptRecords(
        filter.start(prior, first_step, width),
        no_records((runs, nodes), width, nodes),
        np.zeros((runs, width, nodes), dtype=np.int64),
        ((none, np.zeros((runs, nodes), np.int64)),) * int(_late_steps(filter, nodes).max()),
    )


def _late_steps(filter: WindowFilter, nodes: int) -> np.ndarray:
    """From a reading of each node to its delivery, (N,)."""
    return np.array([steps_late(filter, node) for node in range(nodes)])
