"""The node or link at which a ray from the camera points."""

from typing import NamedTuple

import numpy as np

_NODE_REACH, _LINK_REACH = 1.6, 0.6
"""Distances in radii of a node within which a ray meets a node, and a link."""
_SAMPLES = np.linspace(0.12, 0.88, 25)[:, None]
"""Places along a link at which it can be picked: its ends belong to the nodes."""


class Picked(NamedTuple):
    """One node, or the two ends of a link, and where that is in the scene (3,)."""

    nodes: tuple[int, ...]
    place: np.ndarray


def pick(
    origin: np.ndarray, direction: np.ndarray, at: np.ndarray, edges: np.ndarray, radius: float
) -> Picked | None:
    """Return what a ray points at: nodes at (N, 3) of a radius come before links (E, 2) of them."""
    off = _distances(origin, direction, at)
    node = int(np.argmin(off))
    if off[node] <= _NODE_REACH * radius:
        return Picked((node,), at[node])
    if not len(edges):
        return None
    first, second = at[edges[:, 0]], at[edges[:, 1]]
    along = first[:, None] + _SAMPLES * (second - first)[:, None]
    near = _distances(origin, direction, along)
    link, place = np.unravel_index(int(np.argmin(near)), near.shape)
    if near[link, place] > _LINK_REACH * radius:
        return None
    return Picked(tuple(map(int, edges[link])), along[link, place])


def _distances(origin: np.ndarray, direction: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances (...) of points (..., 3) from a ray; infinite behind its origin."""
    ahead = direction / np.linalg.norm(direction)
    offsets = points - origin
    depth = offsets @ ahead
    off = np.linalg.norm(offsets - depth[..., None] * ahead, axis=-1)
    return np.where(depth > 0, off, np.inf)
