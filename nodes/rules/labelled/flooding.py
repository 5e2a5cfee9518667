"""The rule `labelled`: measurements travel, each labelled by its source and step.

A node passes on what a neighbour lacks, counts each record once because it is kept under its label,
and runs one filter over a sliding window. A belief (checkpoint) of the window's base travels only
when a neighbour needs it, and is fused only with the base: what the window holds is not in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky
from concord.nodes.estimator import Rejected
from concord.nodes.messages import Measured, from_wire
from concord.nodes.rules.labelled.frame import LabelledFrameCodec, LabelledShare
from concord.nodes.rules.labelled.kept_records import KeptRecords, nothing_kept
from concord.nodes.rules.labelled.neighbour_records import (
    NeighbourRecords,
    nothing_known,
    overhearing,
)
from concord.nodes.rules.labelled.record_choice import RecordChoice
from concord.nodes.rules.labelled.record_sets import SILENCE, URGENCY, RecordSets, digest_of
from concord.nodes.rules.labelled.source_gate import judged
from concord.nodes.rules.labelled.window_filter import (
    WindowFilter,
    Windows,
    checkpoint_of,
    one_lane,
    steps_late,
)
from concord.nodes.rules.local_filter import SensorGroup, control_of, failure_names

GAP_STEPS = 16  # of silence, after which a neighbour is owed a checkpoint


class LabelledContent(NamedTuple):
    """A node's knowledge.

    Attributes:
        kept: its records. near: what it knows of those of its neighbours.
        owed: a neighbour needs a checkpoint. needs: the node itself needs one, and knows nothing.
        cycle, group: the open group. sent_cycle: the last in which the node sent.
    """

    kept: KeptRecords
    near: NeighbourRecords
    owed: bool
    needs: bool
    cycle: int
    group: int
    sent_cycle: int

    @property
    def windows(self) -> Windows:
        """The window to filter."""
        return self.kept.windows


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
        return self.frames.longest_bytes

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
        return LabelledContent(
            nothing_kept(windows, steps_late(self.filter, self.node)),
            nothing_known(len(self.neighbours[self.node]), self.choice, step),
            owed=False,
            needs=False,
            cycle=self.first_cycle + (step - self.first_step) * self.rounds,
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
        # A neighbour that never got the records forgotten is owed a checkpoint.
        missing = bool((content.kept.held[0] & ~content.near.known[:, 0, 0]).any())
        content = content._replace(
            kept=content.kept.step_begun(self.filter, driven, self.node, record),
            near=content.near.step_begun(),
            owed=content.owed or missing,
        )
        return content, failures

    def bid(self, content: LabelledContent) -> int | None:
        """Return how many records neighbours lack, newer ones counting more; None for none."""
        silent = content.cycle - content.sent_cycle
        urgency = int(self.choice.need(self._doubts(content)))
        # A node that asks for help more than once a step would starve those that can help.
        urgency += URGENCY * (content.owed + (content.needs and silent >= self.rounds))
        return urgency * SILENCE + min(silent, SILENCE - 1) if urgency else None

    def compose(self, content: LabelledContent) -> tuple[LabelledContent, bytes]:
        """A checkpoint if one is owed, and the records that neighbours may lack."""
        base = content.windows.base
        checkpoint = None
        if content.owed and not content.needs and self._has_common_base(content):
            checkpoint = checkpoint_of(self.filter, Gaussian(base.mean[0, 0], base.cov[0, 0]))
        kept = content.kept
        room = self.frames.room(kept.held, np.array(checkpoint is not None))
        costs = self.frames.costs(kept.lengths)
        sent, _ = self.choice.chosen(self._doubts(content), content.near.reports, costs, room)
        digest = digest_of(kept.held, self.frames.digest_steps)
        share = LabelledShare(content.needs, checkpoint, digest, tuple(kept.labelled(sent)))
        content = content._replace(
            near=content.near._replace(sent=sent),
            owed=content.owed and checkpoint is None,
            sent_cycle=content.cycle,
        )
        return content, self.frames.encode(share)

    def _doubts(self, content: LabelledContent) -> RecordSets:
        return self.choice.doubts(content.kept.held, content.near.known)

    def next_bytes(self, content: LabelledContent) -> int:
        """Length of the next share."""
        return len(self.compose(content)[1])

    def accept(self, body: bytes) -> LabelledShare:
        """The share that these bytes mean (`LabelledFrameCodec.decode`)."""
        share = self.frames.decode(body)
        if (sent := share.checkpoint) and not np.isfinite(cholesky(sent.cov)[-1, -1]):
            raise Rejected("not-positive-definite")
        return share

    def fuse(
        self, content: LabelledContent, shares: tuple[LabelledShare | None, ...]
    ) -> tuple[LabelledContent, tuple[str, ...]]:
        """End a group: hold the records received, and note those that neighbours heard."""
        came = [(place, share) for place, share in enumerate(shares) if share is not None]
        for place, share in came:
            content = self._hear(content, place, share)
        shown = ((place, content.kept.set_of(share.records)) for place, share in came)
        near = content.near.told(self.choice, shown, self._overhearing)
        content = content._replace(near=near)
        failures: list[str] = []
        for _, share in came:
            kept, late = content.kept.received(share.records)
            content = content._replace(kept=kept)
            failures += ["record-late"] * late
            if share.checkpoint is not None:
                content, result = self._fuse_base(content, share.checkpoint)
                failures.append(f"checkpoint-{result}")
        return self._closed(content, failures)

    def _hear(self, content: LabelledContent, place: int, share: LabelledShare) -> LabelledContent:
        """Note a neighbour's statements about itself."""
        near, step = content.near, content.windows.step
        strange = step - near.heard[place] > self.gap_steps
        near = near.heard_from(place, step, content.cycle)
        if share.needs:
            # It has lost whatever was sent to it.
            near = near.forgotten(place)
        elif share.digest:
            near = near.reported(self.choice, place, share.digest)
        return content._replace(near=near, owed=content.owed or share.needs or strange)

    def _fuse_base(
        self, content: LabelledContent, checkpoint: Gaussian
    ) -> tuple[LabelledContent, str]:
        """Fuse a checkpoint with the base; what became of it in words."""
        if not self._has_common_base(content):
            return content, "of-another-step"
        kept, result = content.kept.fused(self.filter, checkpoint)
        return content._replace(kept=kept, needs=content.needs and result == "failed"), result

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
            kept, counted = content.kept.filtered(self.filter)
            content = content._replace(kept=kept)
            failures += failure_names(counted)
        return content, tuple(failures)

    def belief(self, content: LabelledContent) -> Gaussian:
        """The posterior of the step; NaN while the node knows nothing."""
        if content.needs:
            return Gaussian(
                np.full_like(self.prior.mean, np.nan), np.full_like(self.prior.cov, np.nan)
            )
        mean, cov = content.windows.beliefs
        return Gaussian(mean[0, 0], cov[0, 0])

    def ages(self, content: LabelledContent) -> np.ndarray:
        """Cycles since each neighbour's last share was sent."""
        return content.near.ages(content.cycle)

    @cached_property
    def _overhearing(self) -> tuple[tuple[int, ...], ...]:
        return overhearing(self.neighbours, self.node)
