"""The shares that the nodes of a network sent, cycle by cycle."""

from typing import NamedTuple

import numpy as np


class SentShares(NamedTuple):
    """Payload bytes of what each node sent in a cycle, the urgency class of its frame IDs, and
    whether only the first frames of its share went; all (..., N). Without `cut` all shares are
    whole."""

    payload_bytes: np.ndarray
    classes: np.ndarray
    cut: np.ndarray | None = None

    @property
    def whole(self) -> "SentShares":
        """Return the shares that are whole."""
        if self.cut is None:
            return self
        return SentShares(np.where(self.cut, 0, self.payload_bytes), self.classes)
