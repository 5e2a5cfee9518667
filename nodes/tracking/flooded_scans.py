"""Labelled scans that flood a network, and the tracks that each node computes from those it holds.

A scan carries its node and its step, so it is used once, in the order of steps and nodes. A node
holds the scans of the last steps open: a scan that comes late takes its place, and the tracks of
the steps from there on are computed anew. Equal scans therefore give equal tracks, bit for bit, in
any order of arrival.
"""

from collections.abc import Callable

import numpy as np

from concord.filters.tracking.tracker import Tracked


def flooded(held: np.ndarray, heard: np.ndarray) -> np.ndarray:
    """Scans that the nodes hold after one round in which each sends all that it holds.

    Args:
        held: (window, N, N), step, holder and origin.
        heard: (N, N), whether the first node hears the second in this round.
    """
    return held | (heard.astype(int) @ held.astype(int) > 0)


class WindowTracks:
    """Tracks of N nodes over a window of steps.

    Nodes with equal tracks before a step and equal scans of it share one computation, as the
    tracker is a function of both.
    """

    def __init__(
        self,
        start: Tracked,
        nodes: int,
        window: int,
        track: Callable[[Tracked, int, bytes], Tracked],
    ) -> None:
        """Begin with equal tracks at all nodes.

        Args:
            start: before the first step.
            nodes: N.
            window: number of steps whose scans may still come.
            track: tracks before a step, the step, and which nodes' scans of it are held (N,) as the
                bytes of booleans -> tracks after it.
        """
        self._settled = [start] * nodes
        self._window, self._track = window, track
        # The tracks before the step are kept beside those after it, so that no other has its id.
        self._shared: dict[tuple[int, int, bytes], tuple[Tracked, Tracked]] = {}

    def at(self, step: int, held: np.ndarray) -> list[Tracked]:
        """Tracks of all nodes after `step`, for `held` (window, N, N) up to it, the newest last."""
        first = step - len(held) + 1
        reached = []
        for node, before in enumerate(self._settled):
            tracked = before
            for place, scans in enumerate(held[:, node]):
                tracked = self._after(tracked, first + place, scans.tobytes())
                if place == 0 and len(held) == self._window:
                    self._settled[node] = tracked
            reached.append(tracked)
        self._shared = {key: kept for key, kept in self._shared.items() if key[1] >= first}
        return reached

    def _after(self, before: Tracked, step: int, scans: bytes) -> Tracked:
        key = (id(before), step, scans)
        if key not in self._shared:
            self._shared[key] = (before, self._track(before, step, scans))
        return self._shared[key][1]
