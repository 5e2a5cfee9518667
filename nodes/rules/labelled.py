"""The rule `labelled`: measurements travel, each labelled by its source and step.

A node passes on what a neighbour lacks, counts each record once because it is kept under its label,
and runs one filter over a sliding window. A belief (checkpoint) of the window's base travels only
when a neighbour needs it, and is fused only with the base: what the window holds is not in it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bus.schedule import Schedule
from filters.fusion.determinant_intersection import determinant_intersection
from filters.gaussian import Gaussian
from nodes.estimator import Rejected
from nodes.messages import Measured, from_wire
from nodes.rules.labelled_frame import Labelled, LabelledFrameCodec, LabelledShare
from nodes.rules.local_filter import finite
from nodes.rules.record_sets import (
    RecordSet,
    lacked,
    need,
    newest_first,
    record_bit,
    sources_at,
    with_sources,
)
from nodes.rules.source_gate import without_outliers
from nodes.rules.window_filter import (
    Window,
    WindowFilter,
    empty_window,
    opened,
    shortened,
    with_base,
    with_records,
)

# A record that one neighbour lacks, and what it loses of that urgency with every step of age.
URGENCY = 65536
_DISCOUNT = 0.9
# Equal needs are served in the order of silence, up to so many cycles.
SILENCE = 4096
# Steps of silence after which a neighbour is owed a checkpoint.
GAP_STEPS = 16


class LabelledContent(NamedTuple):
    """A node's knowledge.

    Attributes:
        window: the window to filter. held: the records in it.
        known: the records that each neighbour is believed to hold.
        confirmed: the records that each neighbour itself reported to hold.
        sent: the content of the share composed in the open group; None if there was none.
        owed: a neighbour needs a checkpoint. needs: the node itself needs one, and knows nothing.
        heard: step at which a share of each neighbour came last.
        share_cycles: cycle of the last share of each neighbour, -1 for never.
        cycle, group: the open group. sent_cycle: the last in which the node sent.
    """

    window: Window
    held: RecordSet
    known: tuple[RecordSet, ...]
    confirmed: tuple[RecordSet, ...]
    sent: RecordSet | None
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
    beyond the chi-square threshold in `gates` is not recorded; none for no such gate.

    Source: the project's study of fusion under bus limits (labelled-measurement flooding).
    """

    node: int
    neighbours: Sequence[Sequence[int]]
    prior: Gaussian
    filter: WindowFilter
    frames: LabelledFrameCodec
    schedule: Schedule
    rounds: int
    gap_steps: int = GAP_STEPS
    gates: tuple[float, ...] = ()
    first_step: int = 0
    first_cycle: int = 0

    @property
    def share_bytes(self) -> int:
        """Length of the longest share."""
        return self.frames.limit_bytes

    def start(self) -> LabelledContent:
        """The common prior, and no record."""
        return self._empty(empty_window(self.first_step - 1, self.prior), self.first_step)

    def restart(self, prior: Gaussian, heartbeats: Sequence[Measured]) -> LabelledContent:
        """A node that has lost everything, before the step after the last of `heartbeats`.

        These are the last steps, a window of them at most. Its beliefs are NaN until a checkpoint
        has come.
        """
        heartbeats = heartbeats[-self.frames.window_steps :]
        window = empty_window(heartbeats[0].step - 1, prior)
        for heartbeat in heartbeats:
            window = opened(window, heartbeat)
        content = self._empty(self.filter.filtered(window)[0], window.step + 1)
        return content._replace(needs=True)

    def _empty(self, window: Window, step: int) -> LabelledContent:
        nobody = (-1,) * len(self._near)
        cycle = self.first_cycle + (step - self.first_step) * self.rounds
        nothing: tuple[RecordSet, ...] = (0,) * len(self._near)
        return LabelledContent(
            window,
            0,
            nothing,
            nothing,
            None,
            False,
            False,
            (step,) * len(self._near),
            nobody,
            cycle,
            0,
            -1,
        )

    def begin_step(
        self, content: LabelledContent, measured: Measured
    ) -> tuple[LabelledContent, tuple[str, ...]]:
        """Let the oldest step go into the base, and record the own readings."""
        if len(content.window.heartbeats) == self.frames.window_steps:
            content = self._shortened(content)
        window = content.window
        delivered = from_wire(measured.readings)
        sensor = self.filter.sensors[self.node]
        failures: tuple[str, ...] = ()
        judged = sensor is not None and (sensor.gate is not None or len(self.gates) > 0)
        # A node that needs a checkpoint has no belief by which to refuse a reading.
        if sensor is not None and judged and not content.needs:
            belief, failures = self.filter.predicted(window.belief, measured)
            delivered, gated = without_outliers(
                belief, delivered, sensor, measured.step, self.filter.points, self.gates
            )
            failures += ("gated",) * int(gated)
        codec = self.filter.codecs[self.node]
        record = None if codec is None else codec.encode(delivered)
        if codec is not None and codec.beyond(delivered):
            failures = (*failures, "record-range")
        content = content._replace(window=opened(window, measured))
        if record is None:
            return content, failures
        return self._with_records(content, {measured.step: {self.node: record}}), failures

    def _shortened(self, content: LabelledContent) -> LabelledContent:
        """The base moves on; a neighbour that never got the step's records is owed a checkpoint."""
        missing = sources_at(lacked(content.held, content.known), 0, self._nodes) > 0
        return content._replace(
            window=shortened(content.window),
            held=content.held >> self._nodes,
            known=tuple(records >> self._nodes for records in content.known),
            confirmed=tuple(records >> self._nodes for records in content.confirmed),
            owed=content.owed or missing,
        )

    def bid(self, content: LabelledContent) -> int | None:
        """How many records the neighbours lack, newer ones counting more; None for none at all.

        An integer. A digest is worth a frame without records: its receivers learn what to resend.
        """
        of_places = self._urgencies[-len(content.window.heartbeats) :]
        urgency = need(content.held, content.known, of_places, self._nodes)
        urgency += URGENCY * (content.owed + content.needs)
        if urgency == 0 and self.frames.digest_steps == 0:
            return None
        return urgency * SILENCE + min(content.cycle - content.sent_cycle, SILENCE - 1)

    def compose(self, content: LabelledContent) -> tuple[LabelledContent, bytes]:
        """A checkpoint if one is owed, and what some neighbour lacks, newest first."""
        window = content.window
        checkpoint = window.base if content.owed and not content.needs else None
        records = self._chosen(content, self.frames.room(checkpoint is not None))
        share = LabelledShare(content.needs, checkpoint, self._digest(content), records)
        newest = len(window.heartbeats) - 1
        sent = sum(record_bit(newest - age, source, self._nodes) for source, age, _ in records)
        owed = content.owed and checkpoint is None
        content = content._replace(sent=sent, owed=owed, sent_cycle=content.cycle)
        return content, self.frames.encode(share)

    def _chosen(self, content: LabelledContent, room: int) -> tuple[Labelled, ...]:
        window = content.window
        newest = len(window.heartbeats) - 1
        chosen: list[Labelled] = []
        for place, source in self._wanted(content):
            record = window.records[place][source]
            room -= self.frames.cost(len(record))
            if room < 0:
                break
            chosen.append(Labelled(source, newest - place, record))
        return tuple(chosen)

    def _wanted(self, content: LabelledContent) -> Iterator[tuple[int, int]]:
        """Yield the records that neighbours are believed to lack, then the unconfirmed ones."""
        missing = lacked(content.held, content.known)
        yield from newest_first(missing, self._nodes)
        if self.frames.digest_steps:
            old = max(len(content.window.heartbeats) - self.frames.digest_steps, 0) * self._nodes
            unsure = lacked(content.held, content.confirmed) & ~missing
            yield from newest_first(unsure >> old << old, self._nodes)

    def _digest(self, content: LabelledContent) -> tuple[int, ...]:
        newest = len(content.window.heartbeats) - 1
        return tuple(
            sources_at(content.held, newest - age, self._nodes) if age <= newest else 0
            for age in range(self.frames.digest_steps)
        )

    def accept(self, body: bytes) -> LabelledShare:
        """The share that these bytes mean (`LabelledFrameCodec.decode`)."""
        share = self.frames.decode(body)
        if share.checkpoint is not None and not _positive_definite(share.checkpoint):
            raise Rejected("not-positive-definite")
        return share

    def fuse(
        self, content: LabelledContent, shares: tuple[LabelledShare | None, ...]
    ) -> tuple[LabelledContent, tuple[str, ...]]:
        """End a group: hold the records received, and note those that neighbours heard."""
        came = [(place, share) for place, share in enumerate(shares) if share is not None]
        for place, share in came:
            content = self._hear(content, place, share)
        if content.sent is not None:
            known = tuple(records | content.sent for records in content.known)
            content = content._replace(known=known, sent=None)
        failures: list[str] = []
        for place, share in came:
            content, late = self._with_records_of(content, place, share)
            failures += late
        return self._closed(content, failures)

    def _hear(self, content: LabelledContent, place: int, share: LabelledShare) -> LabelledContent:
        """Note a neighbour's statements about itself."""
        window = content.window
        theirs, sure = content.known[place], content.confirmed[place]
        for age, sources in enumerate(share.digest[: len(window.heartbeats)]):
            step_place = len(window.heartbeats) - 1 - age
            theirs = with_sources(theirs, step_place, sources, self._nodes)
            sure = with_sources(sure, step_place, sources, self._nodes)
        if share.needs:
            # It has lost whatever was sent to it.
            theirs = sure = 0
        strange = window.step - content.heard[place] > self.gap_steps
        return content._replace(
            known=_replaced(content.known, place, theirs),
            confirmed=_replaced(content.confirmed, place, sure),
            heard=_replaced(content.heard, place, window.step),
            share_cycles=_replaced(content.share_cycles, place, content.cycle),
            owed=content.owed or share.needs or strange,
        )

    def _with_records_of(
        self, content: LabelledContent, place: int, share: LabelledShare
    ) -> tuple[LabelledContent, list[str]]:
        """Take over a neighbour's records, and a base of the same step as the own."""
        window = content.window
        told = 0
        new: dict[int, dict[int, bytes]] = {}
        late = 0
        for source, age, record in share.records:
            step = window.step - age
            if step <= window.base_step:
                late += 1
                continue
            label = record_bit(step - window.base_step - 1, source, self._nodes)
            told |= label
            # The first copy stays: a label is counted once, whatever comes under it.
            if not content.held & label:
                new.setdefault(step, {}).setdefault(source, record)
        witnesses = {place, *self._overhearing[place]}
        known = tuple(
            records | told if other in witnesses else records
            for other, records in enumerate(content.known)
        )
        confirmed = _replaced(content.confirmed, place, content.confirmed[place] | told)
        content = self._with_records(content._replace(known=known, confirmed=confirmed), new)
        failures = ["record-late"] * late
        if share.checkpoint is not None:
            content, fused = self._fuse_base(content, share.checkpoint)
            failures += fused
        return content, failures

    def _with_records(
        self, content: LabelledContent, new: Mapping[int, Mapping[int, bytes]]
    ) -> LabelledContent:
        """With records by step and source that are not held yet."""
        window = content.window
        held = content.held
        for step, by_source in new.items():
            for source in by_source:
                held |= record_bit(step - window.base_step - 1, source, self._nodes)
        return content._replace(window=with_records(window, new), held=held)

    def _fuse_base(
        self, content: LabelledContent, checkpoint: Gaussian
    ) -> tuple[LabelledContent, list[str]]:
        base = determinant_intersection(content.window.base, checkpoint)
        if not finite(base):
            return content, ["checkpoint-failed"]
        content = content._replace(needs=False)
        if base.mean.tobytes() == content.window.base.mean.tobytes():
            return content, ["checkpoint-known"]
        return content._replace(window=with_base(content.window, base)), ["checkpoint-fused"]

    def _closed(
        self, content: LabelledContent, failures: list[str]
    ) -> tuple[LabelledContent, tuple[str, ...]]:
        """Begin the next group of the cycle; at the end of a step filter the window."""
        if content.group + 1 < len(self.schedule.groups(content.cycle)):
            return content._replace(group=content.group + 1), tuple(failures)
        content = content._replace(cycle=content.cycle + 1, group=0)
        if (content.cycle - self.first_cycle) % self.rounds == 0:
            window, failed = self.filter.filtered(content.window)
            content = content._replace(window=window)
            failures += failed
        return content, tuple(failures)

    def belief(self, content: LabelledContent) -> Gaussian:
        """The posterior of the step; NaN while the node knows nothing."""
        if content.needs:
            return Gaussian(
                np.full_like(self.prior.mean, np.nan), np.full_like(self.prior.cov, np.nan)
            )
        return content.window.belief

    def ages(self, content: LabelledContent) -> np.ndarray:
        """Cycles since each neighbour's last share was sent."""
        last = np.array(content.share_cycles, dtype=int)
        return np.where(last < 0, -1, content.cycle - 1 - last)

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

    @cached_property
    def _urgencies(self) -> tuple[int, ...]:
        """Of one lacked record, by age: the oldest that a window can hold first."""
        return urgencies(self.frames.window_steps)


def urgencies(window_steps: int) -> tuple[int, ...]:
    """Of one lacked record of each step of a window, the oldest first."""
    ages = reversed(range(window_steps))
    return tuple(int(URGENCY * _DISCOUNT**age + 0.5) for age in ages)


def _positive_definite(belief: Gaussian) -> bool:
    try:
        np.linalg.cholesky(belief.cov)
    except np.linalg.LinAlgError:
        return False
    return True


def _replaced(values: tuple, place: int, value: object) -> tuple:
    return (*values[:place], value, *values[place + 1 :])
