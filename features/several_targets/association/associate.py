"""Association of tracks and detections: a table of ways from weights to probabilities.

Clusters are tracks that share detections, directly or through other tracks.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from concord.features.several_targets.association.best_hypotheses import (
    MISSED,
    best_hypotheses,
    best_hypothesis,
)
from concord.features.several_targets.association.weights import Association, Weights


def matching_marginals(
    weights: np.ndarray, row_miss: np.ndarray, column_miss: np.ndarray
) -> np.ndarray:
    """Probability (n, m) that a row is matched with a column.

    A matching has as weight the product of the `weights` (n, m) of its pairs, of `row_miss` (n,) of
    the rows and `column_miss` (m,) of the columns that it leaves out. Rows are taken one after the
    other, and only the set of columns that are taken matters to the rows that follow. So n m 2^m
    products replace the sum over all matchings, of which there are more than m!.

    Returns:
        The marginals; NaN where the sum of all weights is 0 or beyond a float.
    """
    rows, columns = weights.shape
    without, beside = _subsets(columns)
    # One entry more than subsets holds the 0 of a set that cannot be.
    forward = np.zeros((rows + 1, 2**columns + 1))
    forward[0, 0] = 1.0
    for row in range(rows):
        before = forward[row]
        forward[row + 1, :-1] = row_miss[row] * before[:-1] + weights[row] @ before[without]
    backward = np.zeros(2**columns + 1)
    backward[:-1] = _left_out(column_miss)
    marginals = np.empty_like(weights)
    for row in reversed(range(rows)):
        taken = backward[beside]
        marginals[row] = weights[row] * (taken @ forward[row, :-1])
        backward[:-1] = row_miss[row] * backward[:-1] + weights[row] @ taken
    with np.errstate(invalid="ignore", divide="ignore"):
        return marginals / backward[0]


@lru_cache(maxsize=32)
def _subsets(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (size, 2^size) of each subset without, and with, each element; 2^size where the
    subset does not have the element, or has it already."""
    subsets, element = np.arange(2**size), 1 << np.arange(size)[:, None]
    has = (subsets & element) != 0
    none = 2**size
    return np.where(has, subsets ^ element, none), np.where(has, none, subsets | element)


def _left_out(column_miss: np.ndarray) -> np.ndarray:
    """Product (2^m,) of `column_miss` (m,) over the columns that each subset lacks."""
    product = np.ones(1)
    for miss in column_miss:
        product = np.concatenate((product * miss, product))
    return product


EXACT_UP_TO = 12
"""Least number of tracks or detections of a cluster above which its sum is not exact."""
BEST = 100
"""Number of hypotheses that stand for all of a cluster that is too large."""
BEST_UP_TO = 30
"""Number of tracks or detections above which the best hypothesis alone stands for all."""


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


def joint_probabilities(weights: Weights, exact_up_to: int = EXACT_UP_TO) -> Association:
    """Joint probabilistic data association.

    The sum over joint hypotheses is exact for each cluster whose tracks or detections number at
    most `exact_up_to`. In a larger one the `BEST` hypotheses of Murty stand for all, and beyond
    `BEST_UP_TO` the best one alone, as Murty's partition takes a time of the fourth power.

    Source: Fortmann, Bar-Shalom and Scheffe (1983), Sonar tracking of multiple targets using joint
    probabilistic data association, IEEE J. Oceanic Engineering 8(3).
    """
    miss, hit = np.ones_like(weights.miss), np.zeros_like(weights.hit)
    approximated = 0
    found = clusters(weights.hit > 0)
    alone = np.array([c.tracks[0] for c in found if len(c.tracks) == 1], dtype=int)
    # A track that shares no detection has the closed form of one target: all such at once.
    total = weights.miss[alone] + weights.hit[alone].sum(axis=1)
    hit[alone] = weights.hit[alone] / total[:, None]
    for cluster in found:
        if len(cluster.tracks) > 1:
            marginals = _exact(weights, cluster, exact_up_to)
            if marginals is None:
                marginals = _by_best(weights, cluster)
                approximated += 1
            hit[np.ix_(*cluster)] = marginals
    tracks = np.concatenate([c.tracks for c in found]) if found else alone
    miss[tracks] = np.maximum(1 - hit[tracks].sum(axis=1), 0)
    return Association(miss, hit, approximated)


def nearest_neighbours(weights: Weights) -> Association:
    """Global nearest neighbour: the joint hypothesis of greatest weight is taken for certain."""
    chosen = best_hypothesis(weights)
    hit = (chosen[:, None] == np.arange(weights.hit.shape[1])).astype(float)
    return Association(np.where(chosen == MISSED, 1.0, 0.0), hit, 0)


ASSOCIATIONS: dict[str, Callable[[Weights], Association]] = {
    "jpda": joint_probabilities,
    "nearest": nearest_neighbours,
}
"""The ways of association by name."""


def _within(weights: Weights, cluster: TrackCluster) -> Weights:
    """Weights of a cluster, the greatest of each track 1."""
    miss, hit = weights.miss[cluster.tracks], weights.hit[cluster.tracks][:, cluster.detections]
    scale = np.maximum(miss, hit.max(axis=1))
    return Weights(miss / scale, hit / scale[:, None])


def _exact(weights: Weights, cluster: TrackCluster, exact_up_to: int) -> np.ndarray | None:
    """Probabilities of a cluster; None where it is too large, or its sum is not a number."""
    if min(map(len, cluster)) > exact_up_to:
        return None
    miss, hit = _within(weights, cluster)
    clutter = np.ones(hit.shape[1])
    # The recursion is over subsets of the smaller side.
    if hit.shape[0] < hit.shape[1]:
        marginals = matching_marginals(hit.T, clutter, miss).T
    else:
        marginals = matching_marginals(hit, miss, clutter)
    return marginals if np.isfinite(marginals).all() else None


def _by_best(weights: Weights, cluster: TrackCluster) -> np.ndarray:
    """Probabilities of a cluster, from its best hypotheses alone."""
    within = _within(weights, cluster)
    number = BEST if min(map(len, cluster)) <= BEST_UP_TO else 1
    chosen, log_weights = best_hypotheses(within, number)
    share = np.exp(log_weights - log_weights[0])
    share /= share.sum()
    columns = np.arange(within.hit.shape[1])
    return np.einsum("k,ktd->td", share, (chosen[:, :, None] == columns).astype(float))
