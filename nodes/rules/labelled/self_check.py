"""A node's check of itself: whether the records of its window fit its belief.

With a matched filter, the normalised innovation squared of all records of a window, added up, is
chi-square with as many degrees of freedom as the records have numbers. A node whose sum is
improbably large has lost the plant, or its model is wrong.

Source: Bar-Shalom, Li and Kirubarajan (2001), Estimation with applications to tracking and
navigation, section 5.4. Wilson and Hilferty (1931), The distribution of chi-square.
"""

from statistics import NormalDist

import numpy as np

from concord.nodes.rules.labelled.window_filter import Windows

SUSPECT = 1e-3
"""Probability at which a sound node calls itself suspect."""
ASKING = 1e-6
"""Probability at which a sound node asks its neighbours for help, which costs frames."""


def is_suspect(windows: Windows, probability: float = SUSPECT) -> np.ndarray:
    """Whether the records of lanes do not fit their beliefs, (R, M).

    The records are those with which the windows were filtered last. A lane without records is not
    suspect: nothing contradicts it.
    """
    entries = windows.entries.sum(axis=-1)
    surprise = windows.surprise.sum(axis=-1)
    return (entries > 0) & (surprise > chi_square_bound(np.maximum(entries, 1), probability))


def chi_square_bound(freedom: np.ndarray, probability: float) -> np.ndarray:
    """Return what chi-square with these degrees of freedom (...) exceeds with a probability.

    The cube root of chi-square over its freedom is nearly normal. For probabilities of 1e-2 to 1e-6
    the bound is too large by at most 13 % at one degree of freedom, and 3 % at five.
    """
    spread = 2 / (9 * freedom)
    deviations = NormalDist().inv_cdf(1 - probability)
    return freedom * (1 - spread + deviations * np.sqrt(spread)) ** 3


def trusting(windows: Windows, lanes: np.ndarray) -> Windows:
    """Forget what these lanes (R, M) held against their beliefs, and filter them from the base."""
    return windows._replace(
        surprise=np.where(lanes[..., None], 0, windows.surprise),
        entries=np.where(lanes[..., None], 0, windows.entries),
        right=np.where(lanes, 0, windows.right),
    )
