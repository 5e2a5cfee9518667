"""The rule `labelled`: measurements travel, each labelled by its source and step.

A node passes on what a neighbour lacks, counts each record once because it is kept under its label,
and runs one filter over a sliding window. A belief (checkpoint) of the window's base travels only
when a neighbour needs it, and is fused only with the base: what the window holds is not in it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky
from concord.nodes.estimator import Rejected
from concord.nodes.messages import Measured, from_wire
from concord.nodes.rules.labelled_frame import Labelled, LabelledFrameCodec, LabelledShare
from concord.nodes.rules.local_filter import SensorGroup, control_of, failure_names
from concord.nodes.rules.record_choice import RecordChoice
from concord.nodes.rules.record_sets import (
    SILENCE,
    URGENCY,
    RecordSets,
    newest_first,
    no_records,
    one_step_on,
    packed,
    with_record,
)
from concord.nodes.rules.source_gate import judged
from concord.nodes.rules.window_filter import WindowFilter, Windows, fuse_base, one_lane, steps_late

GAP_STEPS = 16  # of silence, after which a neighbour is owed a checkpoint


class LabelledContent(NamedTuple):
    """A node's knowledge.

    Attributes:
        windows: the window to filter. records: what was taken by which source, for each place of
            the window. held: the same as a set (W, B).
        waiting: own records that the sensor has yet to deliver, the oldest first.
        unread: (place, source) of the records that the window does not have yet.
        known: (J, K, W, B), what each neighbour was told and has confirmed (`RecordChoice`).
        reports: (2,), the records that digests told of, and those of them that were lacking.
        sent: the content of the share composed in the open group; None if there was none.
        owed: a neighbour needs a checkpoint. needs: the node itself needs one, and knows nothing.
        heard: step at which a share of each neighbour came last.
        share_cycles: cycle of the last share of each neighbour, -1 for never.
        cycle, group: the open group. sent_cycle: the last in which the node sent.
    """

    windows: Windows
    records: tuple[Mapping[int, bytes], ...]
    waiting: tuple[bytes | None, ...]
    unread: tuple[tuple[int, int], ...]
    held: RecordSets
    known: RecordSets
    reports: np.ndarray
    sent: RecordSets | None
    owed: bool
    needs: bool
    heard: tuple[int, ...]
    share_cycles: tuple[int, ...]
    cycle: int
    group: int
    sent_cycle: int


@dataclass(frozen=True)
class LabelledFlooding:
    """The estimator at one node.

    `neighbours` are those of every node, ascending; `prior` is common to all; a neighbour that was
    not heard for more than `gap_steps` is owed a checkpoint. An own reading of 1, 2, ... entries
    beyond the chi-square threshold in `gates` is not recorded; none for no such gate. Nor is a
    reading worth less than `withhold_below` nats. `own` is the node's sensor; none if blind. A
    node that `joins` begins later than its neighbours, with a base of a later step than theirs.

    Source: the project's study of fusion under bus limits (labelled-measurement flooding).
    """

    node: int
    neighbours: Sequence[Sequence[int]]
    prior: Gaussian
    own: tuple[SensorGroup, ...]
    filter: WindowFilter
    frames: LabelledFrameCodec
    choice: RecordChoice
    schedule: Schedule
    rounds: int
    gap_steps: int = GAP_STEPS
    gates: tuple[float, ...] = ()
    withhold_below: float = 0.0
    first_step: int = 0
    first_cycle: int = 0
    joins: bool = False

    @property
    def share_bytes(self) -> int:
        """Length of the longest share."""
        return self.frames.limit_bytes

    def start(self) -> LabelledContent:
        """The common prior, and no record."""
        width = self.frames.window_steps
        windows = self.filter.start(one_lane(self.prior), self.first_step, width)
        return self._empty(windows, self.first_step)

    def restart(self, prior: Gaussian, content: LabelledContent) -> LabelledContent:
        """A node that has lost everything between two steps but what drove the plant.

        Its beliefs are NaN until a checkpoint has come.
        """
        windows = self.filter.forgotten(content.windows, one_lane(prior))
        return self._empty(windows, windows.step + 1)._replace(needs=True)

    def _empty(self, windows: Windows, step: int) -> LabelledContent:
        cycle = self.first_cycle + (step - self.first_step) * self.rounds
        width = self.frames.window_steps
        known = no_records((len(self._near), self.choice.levels), width, self._nodes)
        return LabelledContent(
            windows=windows,
            records=({},) * width,
            waiting=(None,) * steps_late(self.filter, self.node),
            unread=(),
            held=no_records((), width, self._nodes),
            known=known,
            reports=np.zeros(2, dtype=np.int64),
            sent=None,
            owed=False,
            needs=False,
            heard=(step,) * len(self._near),
            share_cycles=(-1,) * len(self._near),
            cycle=cycle,
            group=0,
            sent_cycle=-1,
        )

    def begin_step(
        self, content: LabelledContent, measured: Measured
    ) -> tuple[LabelledContent, tuple[str, ...]]:
        """Let the oldest step go into the base, and record the own readings."""
        delivered, control = from_wire(measured.readings), control_of(measured)
        driven = None if control is None else control[None]
        failures: tuple[str, ...] = ()
        # A node that needs a checkpoint has no belief by which to refuse a reading.
        if not content.needs:
            kept, counted = judged(
                self.filter, content.windows, delivered[None, None], driven, self.own, self.gates,
                self.withhold_below,
            )  # fmt: skip
            delivered, failures = kept[0, 0], failure_names(counted)
        codec = self.filter.codecs[self.node]
        record = None if codec is None else codec.encode(delivered)
        if codec is not None and codec.beyond(delivered):
            failures = (*failures, "record-range")
        record, *waiting = (*content.waiting, record)
        content = self._moved_on(content, driven)._replace(waiting=tuple(waiting))
        if record is None:
            return content, failures
        place = self._newest - len(waiting)
        return self._with_records(content, {(place, self.node): record}), failures

    def _moved_on(self, content: LabelledContent, control: np.ndarray | None) -> LabelledContent:
        """A step later; a neighbour that never got the records forgotten is owed a checkpoint."""
        missing = bool((content.held[0] & ~content.known[:, 0, 0]).any())
        return content._replace(
            windows=self.filter.opened(content.windows, control),
            records=(*content.records[1:], {}),
            held=one_step_on(content.held),
            known=one_step_on(content.known),
            owed=content.owed or missing,
        )

    def bid(self, content: LabelledContent) -> int | None:
        """Return how many records neighbours lack, newer ones counting more; None for none."""
        silent = content.cycle - content.sent_cycle
        urgency = int(self.choice.need(self.choice.doubts(content.held, content.known)))
        # A node that asks for help more than once a step would starve those that can help.
        urgency += URGENCY * (content.owed + (content.needs and silent >= self.rounds))
        return urgency * SILENCE + min(silent, SILENCE - 1) if urgency else None

    def compose(self, content: LabelledContent) -> tuple[LabelledContent, bytes]:
        """A checkpoint if one is owed, and the records that neighbours may lack."""
        base = content.windows.base
        checkpoint = None
        if content.owed and not content.needs and self._has_common_base(content):
            checkpoint = Gaussian(base.mean[0, 0], base.cov[0, 0])
        doubts = self.choice.doubts(content.held, content.known)
        room = self.frames.room(content.held, np.array(checkpoint is not None))
        sent, _ = self.choice.chosen(doubts, content.reports, self._costs(content), room)
        records = tuple(
            Labelled(source, self._newest - place, content.records[place][source])
            for place, source in newest_first(sent, self._nodes)
        )
        share = LabelledShare(content.needs, checkpoint, self._digest(content), records)
        owed = content.owed and checkpoint is None
        content = content._replace(sent=sent, owed=owed, sent_cycle=content.cycle)
        return content, self.frames.encode(share)

    def _costs(self, content: LabelledContent) -> np.ndarray:
        """Bytes of each record in a share, (W, N)."""
        lengths = np.zeros((self.frames.window_steps, self._nodes), dtype=np.int64)
        for place, some in enumerate(content.records):
            for source, record in some.items():
                lengths[place, source] = len(record)
        return self.frames.costs(lengths)

    def _digest(self, content: LabelledContent) -> tuple[int, ...]:
        last = content.held[self.frames.window_steps - self.frames.digest_steps :]
        return tuple(int.from_bytes(sources.tobytes(), "little") for sources in last[::-1])

    def accept(self, body: bytes) -> LabelledShare:
        """The share that these bytes mean (`LabelledFrameCodec.decode`)."""
        share = self.frames.decode(body)
        checkpoint = share.checkpoint
        if checkpoint is not None and not np.isfinite(cholesky(checkpoint.cov)[-1, -1]):
            raise Rejected("not-positive-definite")
        return share

    def fuse(
        self, content: LabelledContent, shares: tuple[LabelledShare | None, ...]
    ) -> tuple[LabelledContent, tuple[str, ...]]:
        """End a group: hold the records received, and note those that neighbours heard."""
        came = [(place, share) for place, share in enumerate(shares) if share is not None]
        for place, share in came:
            content = self._hear(content, place, share)
        content = self._told(content, came)
        failures: list[str] = []
        for place, share in came:
            content, late = self._with_records_of(content, place, share)
            failures += late
        return self._closed(content, failures)

    def _hear(self, content: LabelledContent, place: int, share: LabelledShare) -> LabelledContent:
        """Note a neighbour's statements about itself."""
        known, reports = content.known.copy(), content.reports
        if share.needs:
            # It has lost whatever was sent to it.
            known[place] = 0
        elif share.digest:
            width = content.held.shape[-1]
            digest = b"".join(some.to_bytes(width, "little") for some in share.digest[::-1])
            reported = np.frombuffer(digest, np.uint8).reshape(-1, width)
            known[place], told = self.choice.reported(known[place], reported)
            reports = reports + told
        step = content.windows.step
        strange = step - content.heard[place] > self.gap_steps
        return content._replace(
            known=known,
            reports=reports,
            heard=_replaced(content.heard, place, step),
            share_cycles=_replaced(content.share_cycles, place, content.cycle),
            owed=content.owed or share.needs or strange,
        )

    def _told(
        self, content: LabelledContent, came: Sequence[tuple[int, LabelledShare]]
    ) -> LabelledContent:
        """Note which records neighbours were told of: by the node, by others, and by themselves."""
        told = np.zeros_like(content.known[:, 0])
        shown = np.zeros_like(told)
        if content.sent is not None:
            told |= content.sent
        for place, share in came:
            flags = np.zeros((self.frames.window_steps, self._nodes), dtype=bool)
            for source, age, _ in share.records:
                flags[self._newest - age, source] = self._newest - age >= content.windows.first
            records = packed(flags)
            told[list(self._overhearing[place])] |= records
            shown[place] |= records
        known = self.choice.confirmed(self.choice.told(content.known, told), shown)
        return content._replace(known=known, sent=None)

    def _with_records_of(
        self, content: LabelledContent, place: int, share: LabelledShare
    ) -> tuple[LabelledContent, list[str]]:
        """Take over a neighbour's records, and a base of the same step as the own."""
        first = content.windows.first
        late = 0
        new: dict[tuple[int, int], bytes] = {}
        for source, age, record in share.records:
            step_place = self._newest - age
            if step_place < first:
                late += 1
                continue
            # The first copy stays: a label is counted once, whatever comes under it.
            if source not in content.records[step_place]:
                new.setdefault((step_place, source), record)
        content = self._with_records(content, new)
        failures = ["record-late"] * late
        if share.checkpoint is not None:
            content, fused = self._fuse_base(content, share.checkpoint)
            failures += fused
        return content, failures

    def _with_records(
        self, content: LabelledContent, new: Mapping[tuple[int, int], bytes]
    ) -> LabelledContent:
        """With records by place and source that are not held yet."""
        held, records = content.held, list(content.records)
        for (place, source), record in new.items():
            held = with_record(held, place, source)
            records[place] = {**records[place], source: record}
        return content._replace(records=tuple(records), unread=(*content.unread, *new), held=held)

    def _fuse_base(
        self, content: LabelledContent, checkpoint: Gaussian
    ) -> tuple[LabelledContent, list[str]]:
        if not self._has_common_base(content):
            return content, ["checkpoint-of-another-step"]
        windows = content.windows
        base, sound, gains = fuse_base(self.filter, windows.base, one_lane(checkpoint))
        if not sound.all():
            return content, ["checkpoint-failed"]
        content = content._replace(needs=False)
        if not gains.any():
            return content, ["checkpoint-known"]
        windows = windows._replace(base=base, right=np.zeros_like(windows.right))
        return content._replace(windows=windows), ["checkpoint-fused"]

    def _has_common_base(self, content: LabelledContent) -> bool:
        """Say whether the base is of the step of the neighbours' bases."""
        return not self.joins or content.windows.first == 0

    def _closed(
        self, content: LabelledContent, failures: list[str]
    ) -> tuple[LabelledContent, tuple[str, ...]]:
        """Begin the next group of the cycle; at the end of a step filter the window."""
        if content.group + 1 < len(self.schedule.groups(content.cycle)):
            return content._replace(group=content.group + 1), tuple(failures)
        content = content._replace(cycle=content.cycle + 1, group=0)
        if (content.cycle - self.first_cycle) % self.rounds == 0:
            windows, counted = self.filter.filtered(self._read(content))
            content = content._replace(windows=windows, unread=())
            failures += failure_names(counted)
        return content, tuple(failures)

    def _read(self, content: LabelledContent) -> Windows:
        """The window with what the unread records say."""
        if not content.unread:
            return content.windows
        places = sorted({place for place, _ in content.unread})
        readings = np.full((1, len(places), self._nodes, *self.filter.sensors.delivered), np.nan)
        for place, source in content.unread:
            codec = self.filter.codecs[source]
            assert codec is not None, "the frame codec knows no such source"
            readings[0, places.index(place), source] = codec.decode(content.records[place][source])
        windows = self.filter.with_readings(content.windows, np.array(places), readings)
        return windows._replace(right=np.minimum(windows.right, places[0]))

    def belief(self, content: LabelledContent) -> Gaussian:
        """The posterior of the step; NaN while the node knows nothing."""
        if content.needs:
            return Gaussian(
                np.full_like(self.prior.mean, np.nan), np.full_like(self.prior.cov, np.nan)
            )
        mean, cov = content.windows.beliefs
        return Gaussian(mean[0, 0], cov[0, 0])

    def labels(self, content: LabelledContent) -> set[tuple[int, int]]:
        """The (step, source) of each record in the window."""
        step_at = content.windows.step_at
        return {(step_at(p), source) for p, some in enumerate(content.records) for source in some}

    def ages(self, content: LabelledContent) -> np.ndarray:
        """Cycles since each neighbour's last share was sent."""
        last = np.array(content.share_cycles, dtype=int)
        return np.where(last < 0, -1, content.cycle - 1 - last)

    @property
    def _newest(self) -> int:
        """The place of the step."""
        return self.frames.window_steps - 1

    @property
    def _nodes(self) -> int:
        return len(self.neighbours)

    @property
    def _near(self) -> Sequence[int]:
        return self.neighbours[self.node]

    @cached_property
    def _overhearing(self) -> tuple[tuple[int, ...], ...]:
        """For each neighbour, the places of the others that hear it too."""
        return tuple(
            tuple(
                place for place, other in enumerate(self._near) if sender in self.neighbours[other]
            )
            for sender in self._near
        )


def _replaced(values: tuple, place: int, value: object) -> tuple:
    return (*values[:place], value, *values[place + 1 :])
