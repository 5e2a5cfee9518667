"""A share of tracks as bytes: label, last look, existence and belief of each, then a scan."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from concord.bus.bus import Rejected
from concord.features.several_targets.scan_codec import ScanCodec
from concord.features.several_targets.tracking.track_fusion import LookedAt
from concord.features.several_targets.tracking.tracks import Tracks
from concord.filters.linalg import cholesky
from concord.nodes.share_forms import TwoByteBelief
from concord.nodes.vector_codec import belief_numbers, belief_of

_COUNT_BYTES = 1
# In the place of the number of detections, of which a scan has fewer.
_NO_SCAN = b"\xff"
_OLDEST = 255
_CERTAIN = 2**16 - 1


class TrackShare(NamedTuple):
    """The tracks of a node, and the record of its scan of this step; None where it has none."""

    known: LookedAt
    record: bytes | None


@dataclass(frozen=True)
class TrackCodec:
    """How a share is written: at most `most` confirmed tracks of `states` states, and a scan."""

    states: int
    most: int
    scans: ScanCodec

    @cached_property
    def _form(self) -> TwoByteBelief:
        return TwoByteBelief(self.states)

    @cached_property
    def _row(self) -> np.dtype:
        label = [("step", "<u4"), ("sensor", "u1"), ("place", "u1")]
        belief = ("belief", "<u2", (self._form.length,))
        return np.dtype([*label, ("age", "u1"), ("existence", "<u2"), belief])

    @property
    def size(self) -> int:
        """Length in bytes of the longest share."""
        return _COUNT_BYTES + self.most * self._row.itemsize + self.scans.size_max

    def encode(self, share: TrackShare, step: int) -> bytes:
        """The bytes of a share at a step, with the tracks that most probably exist."""
        shared, record = share
        likely = np.argsort(-shared.tracks.existence, kind="stable")[: self.most]
        tracks, looked = shared.chosen(np.sort(likely))
        rows = np.zeros(len(looked), self._row)
        rows["step"], rows["sensor"], rows["place"] = tracks.identity.T
        rows["age"] = np.minimum(step - looked, _OLDEST)
        rows["existence"] = np.rint(tracks.existence * _CERTAIN)
        rows["belief"] = self._form.codes(belief_numbers(tracks.belief))
        return bytes((len(rows),)) + rows.tobytes() + (_NO_SCAN if record is None else record)

    def decode(self, body: bytes, step: int) -> TrackShare:
        """The share that `encode` wrote in the same step.

        Raises:
            Rejected: `tracks-length`, `tracks-label` for a label twice, or `tracks-belief`.
        """
        count = body[0] if body else 0
        end = _COUNT_BYTES + count * self._row.itemsize
        if count > self.most or len(body) <= end:
            raise Rejected("tracks-length")
        rest, record = body[end:], None
        if rest[:1] != _NO_SCAN:
            record = rest[: self.scans.length(rest)]
            if len(record) < self.scans.length(rest):
                raise Rejected("tracks-length")
        rows = np.frombuffer(body[_COUNT_BYTES:end], self._row)
        labels = [rows[name].astype(int) for name in ("step", "sensor", "place")]
        identity = np.stack(labels, axis=-1)
        if len({tuple(label) for label in identity.tolist()}) < len(rows):
            raise Rejected("tracks-label")
        belief = belief_of(self._form.numbers(rows["belief"]), self.states)
        if not (np.isfinite(belief.mean).all() and np.isfinite(cholesky(belief.cov)).all()):
            raise Rejected("tracks-belief")
        confirmed = np.ones(len(rows), dtype=bool)
        existence = rows["existence"] / _CERTAIN
        tracks = Tracks(belief, existence, identity, confirmed)
        return TrackShare(LookedAt(tracks, step - rows["age"].astype(int)), record)
