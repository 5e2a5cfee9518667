"""The rule `labelled` in arrays: `concord.nodes.rules.labelled` at all nodes of all runs at once.

Both choose their records and filter their windows by the same functions
(`concord.nodes.rules.labelled.record_choice`, `concord.nodes.rules.labelled.window_filter`).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.filter import Counters, added, traffic
from concord.nodes.lanes.kept_records import BatchedKeptRecords, nothing_kept_in_batch
from concord.nodes.lanes.labelled_shares import Came, Shared, as_sent, came_over
from concord.nodes.lanes.links import Links
from concord.nodes.lanes.neighbour_records import BatchedNeighbourRecords, Neighbourhoods
from concord.nodes.lanes.network import ShareContents
from concord.nodes.rules.labelled.flooding import GAP_STEPS
from concord.nodes.rules.labelled.frame import LabelledFrameCodec
from concord.nodes.rules.labelled.record_choice import RecordChoice
from concord.nodes.rules.labelled.record_sets import SILENCE, URGENCY, RecordSets
from concord.nodes.rules.labelled.source_gate import judged
from concord.nodes.rules.labelled.window_filter import WindowFilter, Windows, checkpoint_of
from concord.nodes.rules.lane_rule import NO_BID
from concord.nodes.rules.local_filter import SensorGroup


class BatchedLabelledContent(NamedTuple):
    """Knowledge of all nodes; `concord.nodes.rules.labelled.flooding.LabelledContent` in arrays.

    owed: (R, N). sent_cycle: (R, N). carried: of the step, without what is held.
    """

    kept: BatchedKeptRecords
    near: BatchedNeighbourRecords
    owed: np.ndarray
    sent_cycle: np.ndarray
    cycle: int
    group: int
    carried: np.ndarray
    counters: Counters

    @property
    def windows(self) -> Windows:
        """The windows to filter."""
        return self.kept.windows


@dataclass(frozen=True)
class BatchedFlooding:
    """All nodes of a network; the fields are those of
    `concord.nodes.rules.labelled.flooding.LabelledFlooding`."""

    own: tuple[SensorGroup, ...]
    filter: WindowFilter
    frames: LabelledFrameCodec
    choice: RecordChoice
    links: Links
    schedule: Schedule
    rounds: int
    gates: tuple[float, ...] = ()
    withhold_below: float = 0.0
    first_step: int = 0
    first_cycle: int = 0
    gap_steps: int = GAP_STEPS

    def start(self, prior: Gaussian) -> BatchedLabelledContent:
        """The priors, and no record."""
        shape = prior.mean.shape[:2]
        width = self.frames.window_steps
        return BatchedLabelledContent(
            nothing_kept_in_batch(self.filter, prior, self.first_step, width),
            self._neighbourhoods.start(len(prior.mean), self.first_step),
            owed=np.zeros(shape, dtype=bool),
            sent_cycle=np.full(shape, -1),
            cycle=self.first_cycle,
            group=0,
            carried=np.zeros((3, self.rounds, *shape), dtype=np.int64),
            counters={},
        )

    def begin_step(
        self,
        content: BatchedLabelledContent,
        readings: np.ndarray,
        control: np.ndarray | None,
        step: int,
    ) -> BatchedLabelledContent:
        """Let the oldest step go into the base, and record the own readings."""
        owed = content.owed
        if content.kept.held[:, :, 0].any():
            everybody = (one.ravel() for one in np.indices(owed.shape))
            lacking = self._doubts(content, *everybody)[:, :, 0, 0]
            owed = owed | lacking.any(axis=(1, 2)).reshape(owed.shape)
        readings, failures = judged(
            self.filter, content.windows, readings, control, self.own, self.gates,
            self.withhold_below,
        )  # fmt: skip
        written, beyond = np.full(readings.shape, np.nan), np.zeros(owed.shape, dtype=bool)
        lengths = np.zeros(owed.shape, dtype=np.int64)
        for node, codec in enumerate(self.filter.codecs):
            if codec is not None:
                written[:, node], lengths[:, node] = codec.received(readings[:, node])
                beyond[:, node] = codec.beyond(readings[:, node]) > 0
        return content._replace(
            kept=content.kept.step_begun(self.filter, control, written, lengths),
            near=content.near.step_begun(),
            owed=owed,
            carried=np.zeros_like(content.carried),
            counters=added(added(content.counters, failures), {"record-range": beyond}),
        )

    def bids(self, content: BatchedLabelledContent, nodes: np.ndarray) -> np.ndarray:
        """How many records the neighbours of these nodes (C,) lack: `LabelledFlooding.bid`."""
        shape = (len(content.owed), len(nodes))
        runs, some = (one.ravel() for one in (np.indices(shape)[0], np.broadcast_to(nodes, shape)))
        urgency = self.choice.need(self._doubts(content, runs, some))
        urgency += URGENCY * content.owed[runs, some]
        silent = np.minimum(content.cycle - content.sent_cycle[runs, some], SILENCE - 1)
        bids = np.where(urgency == 0, NO_BID, urgency * SILENCE + silent)
        return bids.reshape(shape)

    def body_bytes(self, content: BatchedLabelledContent, nodes: np.ndarray) -> np.ndarray:
        """Return the lengths (R, C) of the shares that these nodes (C,) would compose now."""
        runs, places = (one.ravel() for one in np.indices((len(content.owed), len(nodes))))
        return self._chosen(content, runs, nodes[places])[1].reshape(-1, len(nodes))

    def exchange(
        self, content: BatchedLabelledContent, sends: np.ndarray, lost: np.ndarray | None
    ) -> BatchedLabelledContent:
        """End a group: nodes compose their shares at once; then all know what they have heard."""
        if not sends.any():
            return self._closed(content)
        content, shares, sound = self._composed(content, *np.nonzero(sends))
        good = np.zeros_like(sends)
        good[shares.runs, shares.nodes] = sound
        came = came_over(self.links, shares, self.links.arriving(good, lost))
        counted = traffic(self.links, good, sends & ~good, lost, "not-positive-definite")
        content = content._replace(counters=added(content.counters, counted))
        content = self._heard(content, shares, came)
        content = content._replace(
            kept=content.kept.received(self.links, shares, came),
            near=self._neighbourhoods.told(content.near, shares, came),
        )
        if shares.with_checkpoint.any():
            content = self._with_checkpoints(content, shares, came)
        return self._closed(content)

    def _composed(
        self, content: BatchedLabelledContent, runs: np.ndarray, nodes: np.ndarray
    ) -> tuple[BatchedLabelledContent, Shared, np.ndarray]:
        """The shares of these nodes, and which of them can be read."""
        records, body_bytes = self._chosen(content, runs, nodes)
        owed, count = content.owed[runs, nodes], np.bitwise_count(records).sum(axis=(1, 2))
        base = Gaussian(*(values[runs, nodes] for values in content.windows.base))
        base = checkpoint_of(self.filter, base)
        codec = self.frames.belief
        checkpoint, sound = as_sent(base, codec) if owed.any() else (base, owed)
        carried, sent_cycle = content.carried.copy(), content.sent_cycle.copy()
        turn = (content.cycle - self.first_cycle) % self.rounds
        for kind, values in enumerate((body_bytes, owed, count)):
            carried[kind, turn, runs, nodes] = values
        sent_cycle[runs, nodes] = content.cycle
        left = content.owed.copy()
        left[runs, nodes] = False
        content = content._replace(owed=left, carried=carried, sent_cycle=sent_cycle)
        return content, Shared(runs, nodes, records, owed, checkpoint), sound | ~owed

    def _chosen(
        self, content: BatchedLabelledContent, runs: np.ndarray, nodes: np.ndarray
    ) -> tuple[RecordSets, np.ndarray]:
        """Return the records and the bytes of shares."""
        owed = content.owed[runs, nodes]
        room = self.frames.room(content.kept.held[runs, nodes], owed)
        records, taken = self.choice.chosen(
            self._doubts(content, runs, nodes),
            content.near.reports[runs, nodes],
            self.frames.costs(content.kept.lengths[runs]),
            room,
        )
        return records, self.frames.limits(owed) - room + taken

    def _heard(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Note the neighbours' statements about themselves."""
        near, step = content.near, content.windows.step
        strange = np.zeros(near.heard.shape, dtype=bool)
        strange[came.runs, came.links] = step - near.heard[came.runs, came.links] > self.gap_steps
        near = near.heard_over(came, step, content.cycle)
        if self.frames.digest_steps:
            near = self._neighbourhoods.reported(near, content.kept.held, came)
        owed = content.owed | (self.links.per_receiver(strange) > 0)
        return content._replace(near=near, owed=owed)

    def _with_checkpoints(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Bases fused with those that came."""
        kept, counted = content.kept.fused(self.filter, self.links, shares, came)
        return content._replace(kept=kept, counters=added(content.counters, counted))

    def _closed(self, content: BatchedLabelledContent) -> BatchedLabelledContent:
        """Begin the next group of the cycle; at the end of a step filter the windows."""
        if content.group + 1 < len(self.schedule.groups(content.cycle)):
            return content._replace(group=content.group + 1)
        content = content._replace(cycle=content.cycle + 1, group=0)
        if (content.cycle - self.first_cycle) % self.rounds:
            return content
        windows, failures = self.filter.filtered(content.windows, content.kept.flags)
        return content._replace(
            kept=content.kept._replace(windows=windows),
            counters=added(content.counters, failures),
        )

    def belief(self, content: BatchedLabelledContent) -> Gaussian:
        """The posteriors of the step."""
        return content.windows.beliefs

    def ages(self, content: BatchedLabelledContent) -> np.ndarray:
        """Cycles since the last share over each link was sent."""
        return content.near.ages(content.cycle)

    def counters(self, content: BatchedLabelledContent) -> Counters:
        """Return the totals."""
        return content.counters

    def spread(self, content: BatchedLabelledContent) -> ShareContents:
        """Return the contents of the step's shares, and the records held at its end."""
        sent, checkpoints, records = content.carried
        return ShareContents(sent, checkpoints, records, content.kept.flags)

    def _doubts(
        self, content: BatchedLabelledContent, runs: np.ndarray, nodes: np.ndarray
    ) -> RecordSets:
        return self._neighbourhoods.doubts(content.near, content.kept.held, runs, nodes)

    @cached_property
    def _neighbourhoods(self) -> Neighbourhoods:
        return Neighbourhoods(self.links, self.choice)
