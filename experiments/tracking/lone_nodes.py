"""Nodes that compute their tracks apart, and whether equal scans gave equal bits."""

from collections.abc import Callable, Sequence
from itertools import combinations

import msgspec
import numpy as np

from concord.filters.tracking.tracker import Tracked
from concord.nodes.tracking.flooded_scans import WindowTracks


class PairsCompared(msgspec.Struct, frozen=True):
    """Pairs of nodes with equal scans up to a step, over all steps, and those that differ."""

    pairs: int
    different: int


def bits_of(tracked: Tracked) -> bytes:
    """Return all numbers of the tracks as bytes."""
    tracks = tracked.tracks
    parts = (*tracks.belief, tracks.existence, tracks.identity, tracks.confirmed)
    return b"".join(part.tobytes() for part in parts)


class LoneNodes:
    """`WindowTracks` of N nodes that share no computation."""

    def __init__(
        self,
        start: Tracked,
        window: int,
        tracks: Sequence[Callable[[Tracked, int, bytes], Tracked]],
    ) -> None:
        """Begin with equal tracks at all nodes; `tracks` has the tracker of each."""
        self._window = window
        self._nodes = [WindowTracks(start, 1, window, track) for track in tracks]
        # The scans that a node used for the steps that no scan can change any more.
        self._settled = [b""] * len(tracks)
        self._pairs, self._different = 0, 0

    def at(self, step: int, held: np.ndarray) -> list[Tracked]:
        """Return what `WindowTracks.at` does, and compare all pairs with equal scans."""
        reached, used = [], []
        for node, alone in enumerate(self._nodes):
            own = held[:, node : node + 1]
            (tracked,) = alone.at(step, own)
            reached.append(tracked)
            used.append(self._settled[node] + own.tobytes())
            if len(held) == self._window:
                self._settled[node] += own[0].tobytes()
        self._compare(used, [bits_of(one) for one in reached])
        return reached

    def _compare(self, used: Sequence[bytes], bits: Sequence[bytes]) -> None:
        for one, other in combinations(range(len(used)), 2):
            if used[one] == used[other]:
                self._pairs += 1
                self._different += bits[one] != bits[other]

    def compared(self) -> PairsCompared:
        """Return the number of pairs so far."""
        return PairsCompared(self._pairs, self._different)
