"""The rule `labelled` in arrays: `concord.nodes.rules.labelled` at all nodes of all runs at once.

Both choose their records and filter their windows by the same functions
(`concord.nodes.rules.record_choice`, `concord.nodes.rules.window_filter`). All nodes begin at the
same step here, so windows have the same steps everywhere, and all copies of a record are alike.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, pack_upper, unpack_upper
from concord.nodes.bids import NO_BID
from concord.nodes.lanes.filter import Counters, added, received, traffic
from concord.nodes.lanes.links import Links, Padded, neighbourhoods, overhearing
from concord.nodes.lanes.network import ShareContents
from concord.nodes.rules.labelled import GAP_STEPS
from concord.nodes.rules.labelled_frame import LabelledFrameCodec
from concord.nodes.rules.local_filter import SensorGroup, finite_lanes
from concord.nodes.rules.record_choice import RecordChoice
from concord.nodes.rules.record_sets import (
    SILENCE,
    URGENCY,
    RecordSets,
    first_places,
    flags_of,
    joined,
    no_records,
    one_step_on,
    packed,
)
from concord.nodes.rules.source_gate import judged
from concord.nodes.rules.window_filter import (
    WindowFilter,
    Windows,
    fuse_base,
    one_place_on,
    steps_late,
)


class BatchedLabelledContent(NamedTuple):
    """Knowledge of all nodes; `concord.nodes.rules.labelled.LabelledContent` in arrays.

    lengths: bytes of each record (R, W, N). waiting: to be delivered. held: (R, N, W, B). known:
    (R, E, K, W, B) of each link, what its sender was told and has confirmed. reports: (R, N, 2).
    owed: (R, N). heard: steps (R, E). share_cycles: (R, E). sent_cycle: (R, N). carried: of the
    step, without what is held.
    """

    windows: Windows
    lengths: np.ndarray
    waiting: tuple[tuple[np.ndarray, np.ndarray], ...]
    held: RecordSets
    known: RecordSets
    reports: np.ndarray
    owed: np.ndarray
    heard: np.ndarray
    share_cycles: np.ndarray
    sent_cycle: np.ndarray
    cycle: int
    group: int
    carried: np.ndarray
    counters: Counters


class Shared(NamedTuple):
    """Shares of lanes (L,): node `nodes` of run `runs` each.

    Their content: records (L, W, B), whether there is a checkpoint (L,), and which it is (L, ...).
    """

    runs: np.ndarray
    nodes: np.ndarray
    records: RecordSets
    with_checkpoint: np.ndarray
    checkpoint: Gaussian


class Came(NamedTuple):
    """Shares (P,) that came: over link `links` in run `runs`, of lane `lanes`; in order of run,
    receiver and sender."""

    runs: np.ndarray
    links: np.ndarray
    lanes: np.ndarray


@dataclass(frozen=True)
class BatchedFlooding:
    """All nodes of a network; the fields are those of
    `concord.nodes.rules.labelled.LabelledFlooding`."""

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
        runs, links = len(prior.mean), len(self.links.sender)
        nothing = partial(no_records, window_steps=self._window, nodes=self._nodes)
        none = np.full((runs, self._nodes, *self.filter.sensors.delivered), np.nan)
        # A node without neighbours has no link, and yet the arrays have a place.
        return BatchedLabelledContent(
            windows=self.filter.start(prior, self.first_step, self._window),
            lengths=np.zeros((runs, self._window, self._nodes), dtype=np.int64),
            waiting=((none, np.zeros(none.shape[:2], np.int64)),) * int(self._late.max()),
            held=nothing((runs, self._nodes)),
            known=nothing((runs, max(links, 1), self.choice.levels)),
            reports=np.zeros((runs, self._nodes, 2), dtype=np.int64),
            owed=np.zeros((runs, self._nodes), dtype=bool),
            heard=np.full((runs, links), self.first_step),
            share_cycles=np.full((runs, links), -1),
            sent_cycle=np.full((runs, self._nodes), -1),
            cycle=self.first_cycle,
            group=0,
            carried=np.zeros((3, self.rounds, runs, self._nodes), dtype=np.int64),
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
        if content.held[:, :, 0].any():
            lacking = self._doubts(content, *self._everybody(len(owed)))[:, :, 0, 0]
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
        oldest = flags_of(content.held[:, :, :1], self._nodes)[:, :, 0]
        windows = self.filter.opened(content.windows, control, oldest)
        held, window_lengths = one_step_on(content.held), one_place_on(content.lengths, 1)
        taken, right = (*content.waiting, (written, lengths)), windows.right
        for late in sorted(set(self._late.tolist())):
            place, (values, sizes) = self._window - 1 - late, taken[-1 - late]
            come = (sizes > 0) & (self._late == late)
            held[:, :, place] |= packed(np.eye(self._nodes, dtype=bool) & come[..., None])
            window_lengths[:, place] += np.where(come, sizes, 0)
            new = np.where(come[..., None, None], values, np.nan)[:, None]
            windows = self.filter.with_readings(windows, np.array([place]), new)
            right = np.where(come, np.minimum(right, place), right)
        return content._replace(
            windows=windows._replace(right=right),
            waiting=taken[1:],
            lengths=window_lengths,
            held=held,
            known=one_step_on(content.known),
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
        came = self._came(shares, self.links.arriving(good, lost))
        counted = traffic(self.links, good, sends & ~good, lost, "not-positive-definite")
        content = content._replace(counters=added(content.counters, counted))
        content = self._told(self._heard(content, shares, came), shares, came)
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
        number = self.frames.belief.number
        checkpoint, sound = _as_sent(base, number) if owed.any() else (base, owed)
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
        room = self.frames.room(content.held[runs, nodes], owed)
        records, taken = self.choice.chosen(
            self._doubts(content, runs, nodes),
            content.reports[runs, nodes],
            self.frames.costs(content.lengths[runs]),
            room,
        )
        return records, self.frames.limit_bytes - room + taken

    def _came(self, shares: Shared, arriving: np.ndarray) -> Came:
        lanes = np.zeros((len(arriving), self._nodes), dtype=np.int64)
        lanes[shares.runs, shares.nodes] = np.arange(len(shares.runs))
        runs, links = np.nonzero(arriving)
        return Came(runs, links, lanes[runs, self.links.sender[links]])

    def _heard(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Note the neighbours' statements about themselves."""
        runs, links, known, reports = came.runs, came.links, content.known, content.reports
        heard, share_cycles = content.heard.copy(), content.share_cycles.copy()
        strange = np.zeros(heard.shape, dtype=bool)
        strange[runs, links] = content.windows.step - heard[runs, links] > self.gap_steps
        heard[runs, links] = content.windows.step
        share_cycles[runs, links] = content.cycle
        if self.frames.digest_steps:
            known, reports = known.copy(), reports.copy()
            last = slice(-self.frames.digest_steps, None)
            digest = content.held[runs, self.links.sender[links], last]
            known[runs, links], told = self.choice.reported(known[runs, links], digest)
            np.add.at(reports, (runs, self.links.receiver[links]), told)
        return content._replace(
            known=known,
            reports=reports,
            owed=content.owed | (self.links.per_receiver(strange) > 0),
            heard=heard,
            share_cycles=share_cycles,
        )

    def _told(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Pass records to the nodes that hear them; each hearer knows that the others hear too."""
        runs, links = came.runs, came.links
        told = shares.records[came.lanes]
        count = content.known.shape[1]
        # A sender takes it that all neighbours hear it.
        lane, place = np.nonzero(self._near.real[shares.nodes])
        own = shares.runs[lane] * count + self._near.links[shares.nodes][lane, place]
        share, place = np.nonzero(self._overheard.real[links])
        also = runs[share] * count + self._overheard.links[links][share, place]
        known = content.known.reshape(-1, *content.known.shape[2:])
        none = np.zeros_like(known[:, 0])
        more, _, _ = joined(
            none, np.concatenate((own, also)), np.concatenate((shares.records[lane], told[share]))
        )
        shown, _, _ = joined(none, runs * count + links, told)
        known = self.choice.confirmed(self.choice.told(known, more), shown)
        held, places, new = joined(
            content.held.reshape(-1, *content.held.shape[2:]),
            runs * self._nodes + self.links.receiver[links],
            told,
        )
        right = content.windows.right.flatten()
        right[places] = np.minimum(right[places], first_places(new))
        return content._replace(
            windows=content.windows._replace(right=right.reshape(content.owed.shape)),
            held=held.reshape(content.held.shape),
            known=known.reshape(content.known.shape),
        )

    def _with_checkpoints(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Bases fused with those that came, sender by sender."""
        base = Gaussian(*(values.copy() for values in content.windows.base))
        right, counters = content.windows.right.copy(), content.counters
        here = shares.with_checkpoint[came.lanes]
        turns = came.links - self.links.offsets[self.links.receiver[came.links]]
        for turn in np.unique(turns[here]):
            some = here & (turns == turn)
            lanes = (came.runs[some], self.links.receiver[came.links[some]])
            before = Gaussian(*(values[lanes] for values in base))
            other = Gaussian(*(values[came.lanes[some]] for values in shares.checkpoint))
            fused, sound, better = fuse_base(self.filter, before, other)
            into = tuple(one[better] for one in lanes)
            base.mean[into], base.cov[into] = fused.mean[better], fused.cov[better]
            right[into] = 0
            for name, some in (("failed", ~sound), ("known", sound & ~better), ("fused", better)):
                count = np.zeros(right.shape, dtype=np.int64)
                count[lanes] = some
                counters = added(counters, {f"checkpoint-{name}": count})
        windows = content.windows._replace(base=base, right=right)
        return content._replace(windows=windows, counters=counters)

    def _closed(self, content: BatchedLabelledContent) -> BatchedLabelledContent:
        """Begin the next group of the cycle; at the end of a step filter the windows."""
        if content.group + 1 < len(self.schedule.groups(content.cycle)):
            return content._replace(group=content.group + 1)
        content = content._replace(cycle=content.cycle + 1, group=0)
        if (content.cycle - self.first_cycle) % self.rounds:
            return content
        held = flags_of(content.held, self._nodes)
        windows, failures = self.filter.filtered(content.windows, held)
        return content._replace(windows=windows, counters=added(content.counters, failures))

    def belief(self, content: BatchedLabelledContent) -> Gaussian:
        """The posteriors of the step."""
        return content.windows.beliefs

    def ages(self, content: BatchedLabelledContent) -> np.ndarray:
        """Cycles since the last share over each link was sent."""
        last = content.share_cycles
        return np.where(last < 0, -1, content.cycle - 1 - last)

    def counters(self, content: BatchedLabelledContent) -> Counters:
        """Return the totals."""
        return content.counters

    def spread(self, content: BatchedLabelledContent) -> ShareContents:
        """Return the contents of the step's shares, and the records held at its end."""
        sent, checkpoints, records = content.carried
        return ShareContents(sent, checkpoints, records, flags_of(content.held, self._nodes))

    def _doubts(
        self, content: BatchedLabelledContent, runs: np.ndarray, nodes: np.ndarray
    ) -> RecordSets:
        """Return the records that these nodes (L,) hold and each neighbour may lack, by how often
        it was told: (L, J, K, W, B).

        Places without a neighbour are empty.
        """
        theirs = content.known[runs[:, None], self._near.links[nodes]]
        doubts = self.choice.doubts(content.held[runs, nodes], theirs)
        return np.where(self._near.real[nodes][..., None, None, None], doubts, np.uint8(0))

    def _everybody(self, runs: int) -> tuple[np.ndarray, np.ndarray]:
        run, node = np.indices((runs, self._nodes))
        return run.ravel(), node.ravel()

    @property
    def _nodes(self) -> int:
        return self.links.nodes

    @cached_property
    def _late(self) -> np.ndarray:
        return np.array([steps_late(self.filter, node) for node in range(self._nodes)])

    @property
    def _window(self) -> int:
        return self.frames.window_steps

    @cached_property
    def _near(self) -> Padded:
        return neighbourhoods(self.links)

    @cached_property
    def _overheard(self) -> Padded:
        return overhearing(self.links)


def _as_sent(base: Gaussian, number: str) -> tuple[Gaussian, np.ndarray]:
    """Return the decoded checkpoints of bases (L, n), and which can be read (L,)."""
    mean, packed_cov = (received(values, number) for values in (base.mean, pack_upper(base.cov)))
    checkpoint = Gaussian(mean, unpack_upper(packed_cov))
    return checkpoint, finite_lanes(Gaussian(mean, cholesky(checkpoint.cov)))
