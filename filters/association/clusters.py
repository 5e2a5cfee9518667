"""Clusters: tracks that share detections, directly or through other tracks."""

from typing import NamedTuple

import numpy as np


class TrackCluster(NamedTuple):
    """Tracks and detections that no possible pair joins with others; indices in order."""

    tracks: np.ndarray
    detections: np.ndarray


def clusters(possible: np.ndarray) -> list[TrackCluster]:
    """Clusters of the pairs (T, D) that are possible, in the order of their first track.

    A track without a possible detection, and a detection without a possible track, is in none.
    """
    found: list[TrackCluster] = []
    left = np.asarray(possible.any(axis=1))
    for first in np.flatnonzero(left):
        if not left[first]:
            continue
        detections = possible[first]
        while True:
            tracks = possible[:, detections].any(axis=1)
            reached = possible[tracks].any(axis=0)
            if (reached == detections).all():
                break
            detections = reached
        left &= ~tracks
        found.append(TrackCluster(np.flatnonzero(tracks), np.flatnonzero(detections)))
    return found
