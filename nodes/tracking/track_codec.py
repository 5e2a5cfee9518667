"""Tracks as the bytes of a share: label, last look, existence, and belief in two-byte numbers."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from concord.bus.bus import Rejected
from concord.filters.linalg import cholesky
from concord.filters.tracking.track_fusion import LookedAt
from concord.filters.tracking.tracks import Tracks
from concord.nodes.belief_codec import belief_numbers, belief_of
from concord.nodes.share_forms import TwoByteBelief

_COUNT_BYTES = 1
_OLDEST = 255
_CERTAIN = 2**16 - 1


@dataclass(frozen=True)
class TrackCodec:
    """How confirmed tracks of `states` states are written: at most `most` of them."""

    states: int
    most: int

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
        return _COUNT_BYTES + self.most * self._row.itemsize

    def encode(self, shared: LookedAt, step: int) -> bytes:
        """The bytes of confirmed tracks at a step, of those that most probably exist."""
        likely = np.argsort(-shared.tracks.existence, kind="stable")[: self.most]
        tracks, looked = shared.chosen(np.sort(likely))
        rows = np.zeros(len(looked), self._row)
        rows["step"], rows["sensor"], rows["place"] = tracks.identity.T
        rows["age"] = np.minimum(step - looked, _OLDEST)
        rows["existence"] = np.rint(tracks.existence * _CERTAIN)
        rows["belief"] = self._form.codes(belief_numbers(tracks.belief))
        return bytes((len(rows),)) + rows.tobytes()

    def decode(self, body: bytes, step: int) -> LookedAt:
        """The tracks that `encode` wrote in the same step.

        Raises:
            Rejected: `tracks-length`, `tracks-label` for a label twice, or `tracks-belief`.
        """
        end = _COUNT_BYTES + (body[0] if body else 0) * self._row.itemsize
        if not _COUNT_BYTES <= end <= min(len(body), self.size):
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
        return LookedAt(
            Tracks(belief, existence, identity, confirmed), step - rows["age"].astype(int)
        )
