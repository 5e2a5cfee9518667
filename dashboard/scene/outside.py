"""Marks at the edge of the map for what lies outside of it: arrows that point there."""

import numpy as np

# Of the half-width of the map: where the marks are.
_EDGE = 1.12
_LENGTH, _HEAD = 1.3, 0.55


def edge_of(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and the upper corner (2,) of the edge around places (P, 2 or more)."""
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1.0)
    return middle - _EDGE * half, middle + _EDGE * half


def is_outside(points: np.ndarray, edge: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return which of points (P, 2 or more) lie outside; a point that is not finite does not."""
    low, high = edge
    return np.asarray(((points[:, :2] < low) | (points[:, :2] > high)).any(axis=1))


def arrows(points: np.ndarray, edge: tuple[np.ndarray, np.ndarray], height: float) -> np.ndarray:
    """Return segments (3 P, 2, 3) of arrows at the edge, from its middle towards points (P, 2)."""
    low, high = edge
    middle, half = (low + high) / 2, (high - low) / 2
    off = points[:, :2] - middle
    share = np.abs(off / half).max(axis=1, keepdims=True)
    tip = middle + off / share
    way = off / np.linalg.norm(off, axis=1, keepdims=True)
    across = np.stack([-way[:, 1], way[:, 0]], axis=1)
    tail = tip - _LENGTH * way
    wings = [tip - _HEAD * way + side * 0.6 * _HEAD * across for side in (-1.0, 1.0)]
    segments = np.stack(
        [np.stack([tail, tip], axis=1), *(np.stack([wing, tip], axis=1) for wing in wings)], axis=1
    ).reshape(-1, 2, 2)
    return np.concatenate([segments, np.full((*segments.shape[:2], 1), height)], axis=-1)
