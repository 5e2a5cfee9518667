"""The arbiters of `bus.arbitration` for many runs at once, where whoever wins fits the segment.

Each arbiter is then an order: the first so many of those who ask win.
"""

from collections.abc import Callable

import numpy as np

Order = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(frame_ids (C,), bids (R, C), last frame ID served (R, 1)) -> urgency (R, C): low numbers first,
ties in order of frame IDs."""


def minislot(frame_ids: np.ndarray, bids: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Low frame IDs first."""
    return np.broadcast_to(frame_ids, bids.shape)


def wtod(frame_ids: np.ndarray, bids: np.ndarray, last: np.ndarray) -> np.ndarray:
    """The largest bids first."""
    return -bids


def round_robin(frame_ids: np.ndarray, bids: np.ndarray, last: np.ndarray) -> np.ndarray:
    """In turn, from the one after the last that was served."""
    return np.broadcast_to(frame_ids <= last, bids.shape)


def serve(
    order: Order,
    last: np.ndarray,
    frame_ids: np.ndarray,
    bids: np.ndarray,
    asks: np.ndarray,
    slots: int,
) -> tuple[np.ndarray, np.ndarray]:
    """The winners (R, C) of contenders whose `frame_ids` (C,) ascend.

    Args:
        order: of the arbiter.
        last: (R,), the last frame ID served (round robin); 0 before the first.
        bids: (R, C), looked at where `asks` (R, C).
        slots: how many may win.

    Returns:
        `last` after the cycle, and the winners.
    """
    urgency = order(frame_ids, bids, last[:, None]).astype(np.int64)
    hopeless = np.iinfo(np.int64).max
    first = np.argsort(np.where(asks, urgency, hopeless), axis=1, kind="stable")[:, :slots]
    wins = np.zeros(bids.shape, dtype=bool)
    np.put_along_axis(wins, first, True, axis=1)
    wins &= asks
    # Round robin goes on after the last of its turn, which comes last in its order.
    served = np.where(np.take_along_axis(wins, first, axis=1), frame_ids[first], 0)
    place = wins.sum(axis=1, keepdims=True) - 1
    latest = np.take_along_axis(served, np.maximum(place, 0), axis=1)[:, 0]
    return np.where(place[:, 0] >= 0, latest, last), wins
