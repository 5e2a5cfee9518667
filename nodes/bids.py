"""How urgently a node asks for a slot in the dynamic segment: by how much it has to tell."""

import numpy as np

from filters.gaussian import Gaussian

FIRST_BID = 2**31 - 1
BID_RESOLUTION = 1 / 1024


def bid_for_change(belief: Gaussian, published: Gaussian, trigger: float) -> int | None:
    """Squared change since the last publication in units of the own covariance, quantised.

    An integer, so that arbitration does not hang on the last bit; below `FIRST_BID`, with which
    asks who has never published. None where the change is below the trigger.
    """
    change = belief.mean - published.mean
    squared = change @ np.linalg.solve(belief.cov, change)
    if squared < trigger:
        return None
    # A change too large for its number, or for any, is as urgent as a change can be.
    urgency = np.nan_to_num(squared / BID_RESOLUTION, nan=np.inf)
    return int(np.clip(urgency, 0, FIRST_BID - 1))
