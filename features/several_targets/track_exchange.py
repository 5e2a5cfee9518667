"""The rule of several targets that shares tracks: nodes track by scans of theirs, and fuse.

A share has the sender's scan of this step and its tracks. A node tracks by its own scan and those
of its neighbours, and fuses its tracks with theirs by covariance intersection. Source: diffusion of
estimates beside measurements of neighbours, Hu, Xie and Zhang (2012), IEEE Trans. Signal
Processing 60(2); tracks of several targets are this project's.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.features.several_targets.scan_flooding import reported_tracks
from concord.features.several_targets.track_codec import TrackCodec, TrackShare
from concord.features.several_targets.tracking.track_fusion import (
    LookedAt,
    fused_tracks,
    tracked_on,
)
from concord.features.several_targets.tracking.tracker import Scan, TrackerSettings
from concord.features.several_targets.tracking.tracks import no_tracks, number_of_targets
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Measured, ReportedTracks, from_wire
from concord.nodes.rules.lane_rule import BIDS_FOR_CHANGE, older

SHARES_IN_STEP = 2
"""A node speaks so often in a step at most, where it contends for slots."""


class TrackContent(NamedTuple):
    """A node's knowledge.

    Attributes:
        settled: tracks at the end of the step before.
        records: scans of this step by node.
        scanned: tracks by the settled ones and the first so many of these scans; the number of
            clusters beyond the bound of the exact sum.
        heard: the last tracks of each neighbour in this step, by its number.
        known: the scanned tracks, fused with those.
        step: this step. rounds: how many of its rounds have ended. spoken: its own shares in it.
        news: shares of neighbours since its last one.
        ages: cycles (J,) since the last share of each neighbour, -1 for never.
    """

    settled: LookedAt
    records: Mapping[int, bytes]
    scanned: tuple[LookedAt, int, int]
    heard: Mapping[int, LookedAt]
    known: LookedAt
    step: int
    rounds: int
    spoken: int
    news: int
    ages: np.ndarray


@dataclass(frozen=True)
class TrackExchange:
    """The estimator at one node; `scan` tells what the record of a node means.

    `undetected` targets are expected that no sensor has seen yet; a step has so many `rounds`.
    Tracks are computed as a step begins, after 1, 2, 4, 8 and so on of its rounds, and at its end.
    """

    node: int
    neighbours: tuple[int, ...]
    scan: Callable[[int, bytes], Scan]
    settings: TrackerSettings
    codec: TrackCodec
    undetected: float
    rounds: int
    first_step: int

    @property
    def share_bytes(self) -> int:
        """Length of the longest share."""
        return self.codec.size

    def start(self) -> TrackContent:
        """No track."""
        nothing = LookedAt(no_tracks(self.codec.states), np.empty(0, dtype=int))
        never, scanned = np.full(len(self.neighbours), -1), (nothing, 0, 0)
        before = self.first_step - 1
        return TrackContent(nothing, {}, scanned, {}, nothing, before, 0, 0, 0, never)

    def begin_step(
        self, content: TrackContent, measured: Measured
    ) -> tuple[TrackContent, tuple[str, ...]]:
        """Predict the tracks and take the own scan."""
        rows = from_wire(measured.readings)
        record = self.codec.scans.encode(rows) if len(rows) else None
        content = content._replace(
            settled=content.known,
            records={} if record is None else {self.node: record},
            scanned=(content.known, -1, 0),
            heard={},
            step=measured.step,
            rounds=0,
            spoken=0,
            news=0,
        )
        return self._tracked(content), ()

    def bid(self, content: TrackContent) -> int | None:
        """Return how much there is to tell; None after two shares in this step, or without news.

        The first share of a step goes before each second one.
        """
        least, most = BIDS_FOR_CHANGE
        if not content.spoken:
            return most
        if content.spoken == SHARES_IN_STEP or not content.news:
            return None
        return min(least * (1 + content.news), most - 1)

    def compose(self, content: TrackContent) -> tuple[TrackContent, bytes]:
        """Return the share to send now: confirmed tracks, and the own scan."""
        known = content.known.chosen(content.known.tracks.confirmed)
        share = TrackShare(known, content.records.get(self.node))
        body = self.codec.encode(share, content.step)
        return content._replace(spoken=content.spoken + 1, news=0), body

    def next_bytes(self, content: TrackContent) -> int:
        """Length of the share that `compose` would return."""
        return len(self.compose(content)[1])

    def accept(self, body: bytes) -> TrackShare:
        """The share that these bytes mean, its tracks looked at so many steps before step 0.

        Raises:
            Rejected: as `TrackCodec.decode`.
        """
        return self.codec.decode(body, 0)

    def fuse(
        self, content: TrackContent, shares: tuple[TrackShare | None, ...]
    ) -> tuple[TrackContent, tuple[str, ...]]:
        """End a round: keep the scans and tracks of the neighbours, and compute the own tracks.

        Failures at the end of a step: each cluster beyond the bound of the exact sum, and each
        confirmed track that finds no room in a share.
        """
        records, heard = dict(content.records), dict(content.heard)
        for node, share in zip(self.neighbours, shares, strict=True):
            if share is not None:
                known, record = share
                heard[node] = known._replace(looked=known.looked + content.step)
                if record is not None:
                    records[node] = record
        here = np.array([share is not None for share in shares], dtype=bool)
        content = content._replace(
            records=records,
            heard=heard,
            rounds=content.rounds + 1,
            ages=np.where(here, 0, older(content.ages)),
            news=content.news + int(here.sum()),
        )
        is_last = content.rounds == self.rounds
        if is_last or not content.rounds & (content.rounds - 1):
            content = self._tracked(content)
        if not is_last:
            return content, ()
        beyond = max(int(content.known.tracks.confirmed.sum()) - self.codec.most, 0)
        approximated = content.scanned[2]
        return content, ("approximated-cluster",) * approximated + ("track-room",) * beyond

    def _tracked(self, content: TrackContent) -> TrackContent:
        """Compute the tracks by all scans of the step, and fuse them in the order of the nodes."""
        known, taken, approximated = content.scanned
        if taken < len(content.records):
            scans = [self.scan(*one) for one in content.records.items()]
            known, approximated = tracked_on(content.settled, scans, self.settings, content.step)
        scanned = known, len(content.records), approximated
        for node in sorted(content.heard):
            known = fused_tracks(known, content.heard[node])
        return content._replace(scanned=scanned, known=known)

    def belief(self, content: TrackContent) -> Gaussian:
        """The number of targets."""
        return number_of_targets(content.known.tracks, self.undetected)

    def tracks(self, content: TrackContent) -> ReportedTracks:
        """The tracks that stand for targets."""
        return reported_tracks(content.known.tracks, b"", self.settings.models.moments)

    def ages(self, content: TrackContent) -> np.ndarray:
        """Cycles since each neighbour's last share was sent."""
        return content.ages
