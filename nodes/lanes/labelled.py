"""The rule `labelled` in arrays: `concord.nodes.rules.labelled` at all nodes of all runs at once.

The sets of records are arrays here, and integers and dictionaries at a node. Both filter their
windows by the same functions (`concord.nodes.rules.window_filter`). No record is late here, so
windows have the same steps everywhere, and all copies of a record are alike.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.filters.fusion.determinant_intersection import determinant_intersection
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, pack_upper, unpack_upper
from concord.nodes.bids import NO_BID
from concord.nodes.lanes.filter import Counters, added, received, traffic
from concord.nodes.lanes.links import Links, Padded, neighbourhoods, overhearing
from concord.nodes.lanes.network import ShareContents
from concord.nodes.lanes.records import (
    RecordSets,
    first_places,
    first_that_fit,
    flags_of,
    joined,
    need,
    no_records,
    one_step_on,
    packed,
)
from concord.nodes.rules.labelled import GAP_STEPS
from concord.nodes.rules.labelled_frame import LabelledFrameCodec
from concord.nodes.rules.local_filter import SensorGroup, finite_lanes
from concord.nodes.rules.record_sets import SILENCE, URGENCY, urgencies
from concord.nodes.rules.source_gate import judged
from concord.nodes.rules.window_filter import WindowFilter, Windows, one_place_on


class BatchedLabelledContent(NamedTuple):
    """Knowledge of all nodes; `concord.nodes.rules.labelled.LabelledContent` in arrays.

    costs: bytes of each record in a share (R, W, N). held: (R, N, W, B). known, confirmed:
    (R, E, W, B) of each link, what its receiver believes that its sender holds, and what that has
    said of itself. owed: (R, N). heard: steps (R, E). share_cycles: (R, E). sent_cycle: (R, N).
    carried: of the step, without what is held.
    """

    windows: Windows
    costs: np.ndarray
    held: RecordSets
    known: RecordSets
    confirmed: RecordSets
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
    links: Links
    schedule: Schedule
    rounds: int
    gates: tuple[float, ...] = ()
    first_step: int = 0
    first_cycle: int = 0
    gap_steps: int = GAP_STEPS

    def start(self, prior: Gaussian) -> BatchedLabelledContent:
        """The priors, and no record."""
        runs, links = len(prior.mean), len(self.links.sender)
        nothing = partial(no_records, window_steps=self._window, nodes=self._nodes)
        # A node without neighbours has no link, and yet the arrays have a place.
        known = nothing((runs, max(links, 1)))
        return BatchedLabelledContent(
            windows=self.filter.start(prior, self.first_step, self._window),
            costs=np.zeros((runs, self._window, self._nodes), dtype=np.int64),
            held=nothing((runs, self._nodes)),
            known=known,
            confirmed=known,
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
            lacking = self._absent(content, *self._everybody(len(owed)))[:, :, 0]
            owed = owed | lacking.any(axis=(1, 2)).reshape(owed.shape)
        readings, failures = judged(
            self.filter, content.windows, readings, control, self.own, self.gates
        )
        written, beyond = np.full(readings.shape, np.nan), np.zeros(owed.shape, dtype=bool)
        lengths = np.zeros(owed.shape, dtype=np.int64)
        for node, codec in enumerate(self.filter.codecs):
            if codec is not None:
                written[:, node], lengths[:, node] = codec.received(readings[:, node])
                beyond[:, node] = codec.beyond(readings[:, node]) > 0
        windows = self.filter.opened(content.windows, control)
        newest = np.array([self._window - 1])
        held, costs = one_step_on(content.held), one_place_on(content.costs, 1)
        held[:, :, -1] = packed(np.eye(self._nodes, dtype=bool) & (lengths > 0)[..., None])
        costs[:, -1] = self.frames.cost(lengths)
        counters = added(content.counters, failures)
        return content._replace(
            windows=self.filter.with_readings(windows, newest, written[:, None]),
            costs=costs,
            held=held,
            known=one_step_on(content.known),
            confirmed=one_step_on(content.confirmed),
            owed=owed,
            carried=np.zeros_like(content.carried),
            counters=added(counters, {"record-range": beyond}),
        )

    def bids(self, content: BatchedLabelledContent, nodes: np.ndarray) -> np.ndarray:
        """How many records the neighbours of these nodes (C,) lack: `LabelledFlooding.bid`."""
        shape = (len(content.owed), len(nodes))
        runs, some = (one.ravel() for one in (np.indices(shape)[0], np.broadcast_to(nodes, shape)))
        absent = self._absent(content, runs, some)
        urgency = need(absent, self._urgencies).sum(axis=1) + URGENCY * content.owed[runs, some]
        silent = np.minimum(content.cycle - content.sent_cycle[runs, some], SILENCE - 1)
        bids = urgency * SILENCE + silent
        if self.frames.digest_steps == 0:
            bids = np.where(urgency == 0, NO_BID, bids)
        return bids.reshape(shape)

    def body_bytes(self, content: BatchedLabelledContent, nodes: np.ndarray) -> np.ndarray:
        """Return the lengths (R, C) of the shares that these nodes (C,) would compose now."""
        runs, places = (one.ravel() for one in np.indices((len(content.owed), len(nodes))))
        return self._chosen(content, runs, nodes[places])[2].reshape(-1, len(nodes))

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
        records, owed, body_bytes, count = self._chosen(content, runs, nodes)
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
    ) -> tuple[RecordSets, np.ndarray, np.ndarray, np.ndarray]:
        """Return records, whether a checkpoint is owed, bytes and number of records of shares."""
        missing = np.bitwise_or.reduce(self._absent(content, runs, nodes), axis=1)
        wanted = (missing,)
        if self.frames.digest_steps:
            unsure = self._absent(content, runs, nodes, content.confirmed)
            unsure = np.bitwise_or.reduce(unsure, axis=1) & ~missing
            unsure[:, : -self.frames.digest_steps] = 0
            wanted = (missing, unsure)
        owed = content.owed[runs, nodes]
        room = np.where(owed, self.frames.room(True), self.frames.room(False))
        records, taken, count = first_that_fit(wanted, content.costs[runs], room)
        return records, owed, self.frames.limit_bytes - room + taken, count

    def _came(self, shares: Shared, arriving: np.ndarray) -> Came:
        lanes = np.zeros((len(arriving), self._nodes), dtype=np.int64)
        lanes[shares.runs, shares.nodes] = np.arange(len(shares.runs))
        runs, links = np.nonzero(arriving)
        return Came(runs, links, lanes[runs, self.links.sender[links]])

    def _heard(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Note the neighbours' statements about themselves."""
        runs, links, known, confirmed = came.runs, came.links, content.known, content.confirmed
        heard, share_cycles = content.heard.copy(), content.share_cycles.copy()
        strange = np.zeros(heard.shape, dtype=bool)
        strange[runs, links] = content.windows.step - heard[runs, links] > self.gap_steps
        heard[runs, links] = content.windows.step
        share_cycles[runs, links] = content.cycle
        if self.frames.digest_steps:
            known, confirmed = known.copy(), confirmed.copy()
            last = slice(-self.frames.digest_steps, None)
            digest = content.held[runs, self.links.sender[links], last]
            known[runs, links, last] = confirmed[runs, links, last] = digest
        return content._replace(
            known=known,
            confirmed=confirmed,
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
        known, _, _ = joined(
            content.known.reshape(-1, *content.known.shape[2:]),
            np.concatenate((own, also)),
            np.concatenate((shares.records[lane], told[share])),
        )
        confirmed = content.confirmed
        if self.frames.digest_steps:
            confirmed, _, _ = joined(
                confirmed.reshape(-1, *confirmed.shape[2:]), runs * count + links, told
            )
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
            confirmed=confirmed.reshape(content.confirmed.shape),
        )

    def _with_checkpoints(
        self, content: BatchedLabelledContent, shares: Shared, came: Came
    ) -> BatchedLabelledContent:
        """Bases fused with those that came, sender by sender."""
        own = content.windows.base
        base = Gaussian(own.mean.copy(), own.cov.copy())
        right, counters = content.windows.right.copy(), content.counters
        here = shares.with_checkpoint[came.lanes]
        turns = came.links - self.links.offsets[self.links.receiver[came.links]]
        for turn in np.unique(turns[here]):
            some = here & (turns == turn)
            lanes = (came.runs[some], self.links.receiver[came.links[some]])
            before = Gaussian(*(values[lanes] for values in base))
            other = Gaussian(*(values[came.lanes[some]] for values in shares.checkpoint))
            fused = determinant_intersection(before, other)
            sound = finite_lanes(fused)
            same = sound & (fused.mean == before.mean).all(axis=-1)
            better = sound & ~same
            into = tuple(one[better] for one in lanes)
            base.mean[into], base.cov[into] = fused.mean[better], fused.cov[better]
            right[into] = 0
            counts = {}
            for name, happened in (("failed", ~sound), ("known", same), ("fused", better)):
                count = np.zeros(right.shape, dtype=np.int64)
                count[lanes] = happened
                counts[f"checkpoint-{name}"] = count
            counters = added(counters, counts)
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

    def _absent(
        self,
        content: BatchedLabelledContent,
        runs: np.ndarray,
        nodes: np.ndarray,
        sets: RecordSets | None = None,
    ) -> RecordSets:
        """Return the records that these nodes (L,) hold and each neighbour lacks: (L, J, W, B).

        Places without a neighbour are empty. With `sets` (R, E, W, B), compare with those sets
        instead of the known ones.
        """
        theirs = (content.known if sets is None else sets)[runs[:, None], self._near.links[nodes]]
        absent = content.held[runs, nodes][:, None] & ~theirs
        return np.where(self._near.real[nodes][..., None, None], absent, np.uint8(0))

    def _everybody(self, runs: int) -> tuple[np.ndarray, np.ndarray]:
        run, node = np.indices((runs, self._nodes))
        return run.ravel(), node.ravel()

    @property
    def _nodes(self) -> int:
        return self.links.nodes

    @property
    def _window(self) -> int:
        return self.frames.window_steps

    @cached_property
    def _urgencies(self) -> np.ndarray:
        return np.array(urgencies(self._window))

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
