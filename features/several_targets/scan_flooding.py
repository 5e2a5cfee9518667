"""Scans as labelled records: flooding brings them to a node, whose tracks are a function of them.

The records of a step are used in the order of their sources, and steps in their order. A record
that comes late takes its place in the window, and the tracks are computed again from there. Equal
records therefore give equal tracks, bit for bit, in any order of arrival. No checkpoint travels: a
node that returns begins its tracks with the scans that it gets.
"""

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.bus.bus import Rejected
from concord.features.several_targets.tracking.tracker import Tracked
from concord.features.several_targets.tracking.tracks import Tracks, number_of_targets, report
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Measured, ReportedTracks
from concord.nodes.rules.labelled.flooding import LabelledContent, LabelledFlooding
from concord.nodes.rules.labelled.frame import LabelledShare
from concord.nodes.rules.labelled.kept_steps import KeptSteps
from concord.nodes.rules.labelled.window_filter import WindowFilter, Windows
from concord.nodes.rules.lane_rule import Failures

StepRecords = tuple[tuple[int, bytes], ...]
"""(source, record) of a step, sources ascending."""
_DIGEST_BYTES = 8
"""Two of 10^5 different digests are equal with a probability of 3e-10."""
TrackStep = Callable[[Tracked, int, StepRecords], Tracked]
"""Tracks before a step, the step, and its records -> tracks after it."""


class RecordsAlone(WindowFilter):
    """A window that keeps records, and believes nothing of any state."""

    def with_readings(self, windows: Windows, places: np.ndarray, delivered: np.ndarray) -> Windows:
        """Return the windows as they are."""
        return windows

    def filtered(
        self, windows: Windows, held: np.ndarray | None = None
    ) -> tuple[Windows, Failures]:
        """Return the windows as they are."""
        return windows, {}


class Reached(NamedTuple):
    """Tracks after a step, its records, and a digest of all records up to it."""

    step: int
    tracked: Tracked
    records: StepRecords
    evidence: bytes


class TrackedWindow(NamedTuple):
    """Tracks of one node over the steps of its window.

    Attributes:
        settled: tracks after the steps that have left the window.
        reached: those after each step of the window that has ended, the oldest first.
    """

    settled: Reached
    reached: tuple[Reached, ...]

    @property
    def last(self) -> Reached:
        """Tracks after the last step that has ended."""
        return self.reached[-1] if self.reached else self.settled

    def after(
        self, track: TrackStep, steps: Iterable[tuple[int, StepRecords]], is_full: bool
    ) -> "TrackedWindow":
        """The tracks by the records that are held now, of all steps of the window.

        No record of the oldest step of a full window can come any more.
        """
        before = {one.step: one for one in self.reached}
        newest, found = self.settled, []
        for step, held in steps:
            known = before.get(step)
            if known is None or known.records != held or newest is not before.get(step - 1, newest):
                tracked = track(newest.tracked, step, held)
                known = Reached(step, tracked, held, _digest(newest.evidence, held))
            found.append(newest := known)
        if is_full:
            return TrackedWindow(found[0], tuple(found[1:]))
        return self._replace(reached=tuple(found))


class ScanContent(NamedTuple):
    """A node's knowledge: the records of the window, and the tracks."""

    flooded: LabelledContent
    window: TrackedWindow


@dataclass(frozen=True)
class ScanFlooding:
    """The estimator at one node: `flooding` brings records, `track` makes tracks of them.

    `undetected` targets are expected that no sensor has seen yet; `moments` gives mean and
    covariance of the belief of a track.
    """

    flooding: LabelledFlooding
    track: TrackStep
    begin: Tracked
    undetected: float
    moments: Callable[[Gaussian], Gaussian]

    @property
    def share_bytes(self) -> int:
        """Length of the longest share."""
        return self.flooding.share_bytes

    def start(self) -> ScanContent:
        """No record and no track."""
        before = self.flooding.first_step - 1
        window = TrackedWindow(Reached(before, self.begin, (), b""), ())
        return ScanContent(self.flooding.start(), window)

    def begin_step(
        self, content: ScanContent, measured: Measured
    ) -> tuple[ScanContent, tuple[str, ...]]:
        """Let the oldest step leave the window, and record the own scan."""
        flooded, failures = self.flooding.begin_step(content.flooded, measured)
        return _with_flooded(content, flooded), failures

    def bid(self, content: ScanContent) -> int | None:
        """Return the urgency of the records that neighbours lack (`LabelledFlooding.bid`)."""
        return self.flooding.bid(content.flooded)

    def compose(self, content: ScanContent) -> tuple[ScanContent, bytes]:
        """Return the share to send now: records that neighbours may lack."""
        flooded, body = self.flooding.compose(content.flooded)
        return _with_flooded(content, flooded), body

    def next_bytes(self, content: ScanContent) -> int:
        """Length of the share that `compose` would return."""
        return self.flooding.next_bytes(content.flooded)

    def accept(self, body: bytes) -> LabelledShare:
        """The share that these bytes mean.

        Raises:
            Rejected: as `LabelledFlooding.accept`, and `labelled-checkpoint` for a checkpoint.
        """
        share = self.flooding.accept(body)
        if share.checkpoint is not None:
            raise Rejected("labelled-checkpoint")
        return share

    def fuse(
        self, content: ScanContent, shares: tuple[LabelledShare | None, ...]
    ) -> tuple[ScanContent, tuple[str, ...]]:
        """End a group: hold the records received; at the end of a step compute the tracks.

        Each cluster of the step beyond the bound of the exact sum counts as a failure.
        """
        flooded, failures = self.flooding.fuse(content.flooded, shares)
        rounds = flooded.cycle - self.flooding.first_cycle
        is_end = flooded.group == 0 and rounds % self.flooding.rounds == 0
        content = _with_flooded(content, flooded)
        if not is_end:
            return content, failures
        content = self._tracked(content)
        return content, (
            *failures,
            *["approximated-cluster"] * content.window.last.tracked.approximated,
        )

    def _tracked(self, content: ScanContent) -> ScanContent:
        windows, records = content.flooded.windows, content.flooded.kept.records
        steps = (
            (windows.step_at(place), tuple(sorted(records[place].items())))
            for place in range(windows.first, len(records))
        )
        return content._replace(window=content.window.after(self.track, steps, windows.first == 0))

    def belief(self, content: ScanContent) -> Gaussian:
        """The number of targets."""
        return number_of_targets(content.window.last.tracked.tracks, self.undetected)

    def tracks(self, content: ScanContent) -> ReportedTracks:
        """The tracks that stand for targets."""
        last = content.window.last
        return reported_tracks(last.tracked.tracks, last.evidence, self.moments)

    def ages(self, content: ScanContent) -> np.ndarray:
        """Cycles since each neighbour's last share was sent."""
        return self.flooding.ages(content.flooded)


def reported_tracks(
    tracks: Tracks, evidence: bytes, moments: Callable[[Gaussian], Gaussian]
) -> ReportedTracks:
    """Return tracks as an estimate tells them; `evidence` is a digest of what went into them."""
    every = (*tracks.belief, tracks.existence, tracks.identity, tracks.confirmed)
    bits = hashlib.sha256(b"".join(one.tobytes() for one in every)).digest()
    short = (evidence[:_DIGEST_BYTES].hex(), bits[:_DIGEST_BYTES].hex())
    return ReportedTracks(report(tracks, moments).rows.tolist(), *short)


def _with_flooded(content: ScanContent, flooded: LabelledContent) -> ScanContent:
    """Return the content with these records; no neighbour is owed a checkpoint."""
    return content._replace(flooded=flooded._replace(owed=False))


def _digest(before: bytes, records: StepRecords) -> bytes:
    known = hashlib.sha256(before)
    # A step without records differs from no step.
    known.update(b"%d " % len(records))
    for source, record in records:
        known.update(b"%d %d " % (source, len(record)) + record)
    return known.digest()


class KeptTracks:
    """A tracker that keeps its results of the last `steps` steps.

    Nodes of one process that share it compute tracks of equal records once.
    """

    def __init__(self, track: TrackStep, steps: int) -> None:
        self._track = track
        # The tracks before the step are kept beside those after it, so that no other has its id.
        self._kept = KeptSteps[tuple[Tracked, Tracked]](steps)

    def __call__(self, before: Tracked, step: int, records: StepRecords) -> Tracked:
        """Return the tracks after a step."""
        key = (id(before), records)
        return self._kept.of(step, key, lambda: (before, self._track(before, step, records)))[1]
