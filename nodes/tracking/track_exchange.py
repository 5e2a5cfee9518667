"""The rule of several targets that shares tracks: each node tracks by its own scans, and fuses."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.tracking.track_fusion import LookedAt, fused_tracks
from concord.filters.tracking.tracker import Scan, ScanSensor, TrackerSettings, track
from concord.filters.tracking.tracks import no_tracks, number_of_targets
from concord.nodes.messages import Measured, ReportedTracks, from_wire
from concord.nodes.rules.lane_rule import older
from concord.nodes.tracking.scan_flooding import reported_tracks
from concord.nodes.tracking.track_codec import TrackCodec

LOOKS_FROM = 0.1
"""Detection probability from which a scan is a look at a place."""


class TrackContent(NamedTuple):
    """A node's knowledge: its tracks, the step, cycles (J,) since the last share of each neighbour,
    -1 for never, and cycles since the own last share."""

    known: LookedAt
    step: int
    ages: np.ndarray
    silent: int


@dataclass(frozen=True)
class TrackExchange:
    """The estimator at one node.

    `undetected` targets are expected that no sensor has seen yet.
    """

    node: int
    neighbours: int
    sensor: ScanSensor
    settings: TrackerSettings
    codec: TrackCodec
    undetected: float
    first_step: int

    @property
    def share_bytes(self) -> int:
        """Length of the longest share."""
        return self.codec.size

    def start(self) -> TrackContent:
        """No track."""
        nothing = LookedAt(no_tracks(self.codec.states), np.empty(0, dtype=int))
        never = np.full(self.neighbours, -1)
        return TrackContent(nothing, self.first_step - 1, never, 0)

    def begin_step(
        self, content: TrackContent, measured: Measured
    ) -> tuple[TrackContent, tuple[str, ...]]:
        """Predict the tracks and take the own scan.

        Failures: each cluster beyond the bound of the exact sum, and each confirmed track that
        finds no room in a share.
        """
        step, rows = measured.step, from_wire(measured.readings)
        scans = []
        if len(rows) and not np.isnan(rows[0, 0]):
            scans = [Scan(self.node, self.sensor, rows[1 : 1 + int(rows[0, 0])])]
        tracks, approximated = track(content.known.tracks, scans, self.settings, step)
        before = zip(content.known.tracks.identity.tolist(), content.known.looked, strict=True)
        last = {tuple(label): looked for label, looked in before}
        looked = np.array([last.get(tuple(one), step) for one in tracks.identity.tolist()], int)
        if scans:
            seen = self.sensor.detection_probability(tracks.belief.mean) >= LOOKS_FROM
            looked = np.where(seen, step, looked)
        known = LookedAt(tracks, looked)
        beyond = max(int(tracks.confirmed.sum()) - self.codec.most, 0)
        failures = ("approximated-cluster",) * approximated + ("track-room",) * beyond
        return content._replace(known=known, step=step), failures

    def bid(self, content: TrackContent) -> int | None:
        """Return the cycles since the last share; None without a confirmed track."""
        return content.silent + 1 if content.known.tracks.confirmed.any() else None

    def compose(self, content: TrackContent) -> tuple[TrackContent, bytes]:
        """Return the share to send now: confirmed tracks."""
        known = content.known
        body = self.codec.encode(known.chosen(known.tracks.confirmed), content.step)
        return content._replace(silent=0), body

    def accept(self, body: bytes) -> LookedAt:
        """The tracks that these bytes mean, looked at so many steps before step 0.

        Raises:
            Rejected: as `TrackCodec.decode`.
        """
        return self.codec.decode(body, 0)

    def fuse(
        self, content: TrackContent, shares: tuple[LookedAt | None, ...]
    ) -> tuple[TrackContent, tuple[str, ...]]:
        """End a round: fuse the tracks of the neighbours, in their order."""
        known = content.known
        for share in shares:
            if share is not None:
                known = fused_tracks(known, share._replace(looked=share.looked + content.step))
        heard = np.array([share is not None for share in shares], dtype=bool)
        ages = np.where(heard, 0, older(content.ages))
        return content._replace(known=known, ages=ages, silent=content.silent + 1), ()

    def belief(self, content: TrackContent) -> Gaussian:
        """The number of targets."""
        return number_of_targets(content.known.tracks, self.undetected)

    def tracks(self, content: TrackContent) -> ReportedTracks:
        """The tracks that stand for targets."""
        return reported_tracks(content.known.tracks, b"", self.settings.models.moments)

    def ages(self, content: TrackContent) -> np.ndarray:
        """Cycles since each neighbour's last share was sent."""
        return content.ages
