"""Urgency classes: which of its frame IDs a contender of the dynamic segment sends in.

FlexRay serves the frame ID that comes first and knows no bids. A node that owns one ID in each of
several classes, the most urgent class first, tells its urgency by the ID that its host chooses.
"""

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import Numbers


class UrgencyClasses:
    """Classes 0 (first on the bus) to `count` - 1 of bids between `least_bid` and `most_bid`.

    Bids have the classes from 1 on, at equal ratios of bids. Class 0 is for contenders that have
    asked in vain `old_after` times in a row, whatever they bid. A winner leaves class 0 for as
    long as that, which bounds the wait of all others (`bus/longest_wait.py`). With `count` 1 a node
    has one frame ID, bids do not matter, and no node grows old.

    Raises:
        ValueError: no class, or an empty range of bids.
    """

    def __init__(
        self, count: int = 1, least_bid: int = 1 << 20, most_bid: int = 1 << 51, old_after: int = 1
    ) -> None:
        if count < 1 or not 0 < least_bid < most_bid or old_after < 1:
            raise ValueError(
                f"{count} urgency classes of bids from {least_bid} to {most_bid}, old after "
                f"{old_after} waits: give at least one class, bids rising from above 0, and an age"
            )
        self.count = count
        self.old_after = old_after if count > 1 else None
        self._least_bid, self._ratio = least_bid, most_bid / least_bid
        self._borders = self.spread(np.arange(1, count - 1) / max(1, count - 1))

    def of(self, bids: Numbers, waits: Numbers) -> NDArray[np.int64]:
        """Return the class of each bid (...) of a contender that asked in vain `waits` (...) times
        in a row."""
        if self.old_after is None:
            return np.zeros(bids.shape, dtype=np.int64)
        classes = self.count - 1 - np.searchsorted(self._borders, bids, side="right")
        return np.where(waits >= self.old_after, 0, classes)

    def spread(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the bids at these places of the range on a logarithmic scale: 0 is its beginning,
        1 and what is beyond its end."""
        return np.rint(self._least_bid * self._ratio ** np.minimum(places, 1.0)).astype(np.int64)


ONE_CLASS = UrgencyClasses()
