"""The fault-tolerant midpoint of FlexRay 2.1, 8.6.1 (Welch and Lynch 1988)."""

import numpy as np

from concord.bus.arbitration import Numbers
from concord.bus.flexray.clocks.settings import Mask

_BEYOND = np.iinfo(np.int64).max
# Fewer values than these leave out none, one and two at either end.
_FEW, _MANY = 3, 8


def midpoint(values: Numbers, known: Mask) -> Numbers:
    """Return the mean of the smallest and the largest value after the extremes are left out.

    The extremes are 0, 1 or 2 at either end, for up to 2, up to 7, and more values. An odd sum is
    halved towards zero.

    Args:
        values: (..., S), deviations in microticks.
        known: (..., S), which of them were measured.

    Returns:
        (...), 0 where no value is known.
    """
    count = known.sum(axis=-1, keepdims=True)
    ordered = np.sort(np.where(known, values, _BEYOND), axis=-1)
    out = (count >= _FEW).astype(np.int64) + (count >= _MANY)
    low = np.take_along_axis(ordered, np.minimum(out, np.maximum(count - 1, 0)), axis=-1)
    high = np.take_along_axis(ordered, np.maximum(count - 1 - out, 0), axis=-1)
    some = count[..., 0] > 0
    both = np.where(some, low[..., 0], 0) + np.where(some, high[..., 0], 0)
    return np.sign(both) * (np.abs(both) // 2)
