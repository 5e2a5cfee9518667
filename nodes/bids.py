"""How urgently a node asks for a slot in the dynamic segment: by how much it has to tell."""

import numpy as np

from concord.bus.arbitration import NO_BID
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import solve_spd

FIRST_BID = 2**31 - 1
BID_RESOLUTION = 1 / 1024
BIDS_FOR_CHANGE = (64, 65536)
"""Bids between which urgency is told apart: of squared changes from 1/16 to 64."""


def bid_for_change(belief: Gaussian, published: Gaussian, trigger: float) -> np.ndarray:
    """Squared change since the last publication in units of the own covariance, quantised.

    Integers (...) for beliefs (..., n), so that arbitration does not hang on the last bit; below
    `FIRST_BID`, with which asks who has never published. `NO_BID` where the change is below the
    trigger.
    """
    change = belief.mean - published.mean
    squared = (change * solve_spd(belief.cov, change[..., None])[..., 0]).sum(axis=-1)
    # A change too large for its number, or for any, is as urgent as a change can be.
    urgency = np.nan_to_num(squared / BID_RESOLUTION, nan=np.inf)
    bids = np.clip(urgency, 0, FIRST_BID - 1).astype(np.int64)
    return np.where(squared < trigger, NO_BID, bids)


def asked(bid: np.ndarray) -> int | None:
    """One bid as a message carries it: None asks for nothing."""
    return None if bid == NO_BID else int(bid)
