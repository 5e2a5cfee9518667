"""A round of averaging at all nodes of many runs, as a matrix: weights, and sums along links."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from concord.nodes.lanes.links import Links, Shares
from concord.nodes.rules.belief_consensus import HoldPolicy

_ALIKE = np.ones(1)

# Up to so many nodes a full matrix is multiplied faster than a sparse one, and many rounds of it
# cost what one costs.
FEW_NODES = 64


class Mixing(NamedTuple):
    """Fusion weights of all nodes, of each of R runs or of one where they do not differ.

    own: (R or 1, N). link: for numbers in K slots, (N, K), or the blocks of all runs on the
    diagonal of one matrix; an array or a sparse matrix of scipy. whole: for numbers that all nodes
    have just shared, own ones included, (N, N); None where runs differ or a slot is not a node.
    """

    own: np.ndarray
    link: Any
    whole: Any


def weighed(
    links: Links,
    base: Shares,
    ages: np.ndarray,
    weigh: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Mixing:
    """Fusion weights of all nodes by `weigh(base (..., J), ages (..., J))`.

    Args:
        base: of one run: own (1, N), link (1, E).
        ages: of links (R, E), or (1, E) where runs do not differ; the own is 0.
        weigh: a rule for one neighbourhood, its own node first.
    """
    own, link = np.empty((len(ages), links.nodes)), np.empty((len(ages), len(links.sender)))
    for some, row in zip(links.classes, links.rows(base), strict=True):
        neighbour_ages = some.gathered(ages, -1)
        self_heard = np.zeros((*neighbour_ages.shape[:-1], 1), dtype=ages.dtype)
        weights = weigh(row, np.concatenate((self_heard, neighbour_ages), axis=-1))
        own[:, some.nodes] = weights[..., 0]
        link[:, some.links[some.real]] = weights[..., 1:][:, some.real]
    alike = len(ages) == 1 and links.perfect
    matrix = _matrix(links, link)
    if alike and links.nodes <= FEW_NODES:
        matrix = matrix.toarray()
        return Mixing(own, matrix, matrix + np.diag(own[0]))
    # Only here, as below.
    from scipy.sparse import diags_array

    return Mixing(own, matrix, (matrix + diags_array(own[0])).tocsr() if alike else None)


class MixingWeights:
    """The weights of a network in each turn of a step, beliefs as sharp as each other."""

    def __init__(self, links: Links, base: Shares, hold: HoldPolicy) -> None:
        self._links, self._base, self._hold = links, base, hold
        # Kept: few patterns of ages come again and again.
        self._of_one = lru_cache(maxsize=16)(self._from_bytes)

    def at(self, ages: np.ndarray, turn: int) -> Mixing:
        """Return the weights at ages (R, E), or (1, E), in a turn of the step."""
        return self._of_one(ages.tobytes(), turn) if len(ages) == 1 else self._of(ages, turn)

    def _from_bytes(self, ages: bytes, turn: int) -> Mixing:
        return self._of(np.frombuffer(ages, dtype=np.int64)[None], turn)

    def _of(self, ages: np.ndarray, turn: int) -> Mixing:
        def weigh(base: np.ndarray, ages: np.ndarray) -> np.ndarray:
            return self._hold.weigh(base, ages, _ALIKE, turn)

        return weighed(self._links, self._base, ages, weigh)


def _matrix(links: Links, weights: np.ndarray) -> Any:
    """Sums over the slots that nodes hear, as a sparse matrix of one block for each run."""
    # Only here: a node process that knows this file must not load it.
    from scipy.sparse import csr_array

    runs, count = weights.shape
    nodes, slots = links.nodes, len(links.source)
    each = np.arange(runs)[:, None]
    columns = (each * slots + links.slot).ravel()
    rows = np.append((each * count + links.offsets[:-1]).ravel(), runs * count)
    return csr_array((weights.ravel(), columns, rows), shape=(runs * nodes, runs * slots))


def mixed(mixing: Mixing, own: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Weighted sums (R, N, m) of the nodes' own numbers (R, N, m) and of those in slots (R, K,
    m), which may be the very same; lanes last in memory."""
    if own is held and mixing.whole is not None:
        return summed(mixing.whole, held)
    total = mixing.own[..., None] * own
    if held.shape[1]:
        total += summed(mixing.link, held)
    return total


def summed(matrix: Any, values: np.ndarray) -> np.ndarray:
    """A matrix (N, K), or one with a block for each run, times values (R, K, m): (R, N, m), lanes
    last in memory."""
    runs, slots, m = values.shape
    if isinstance(matrix, np.ndarray):
        sums = values.transpose(2, 0, 1).reshape(-1, slots) @ matrix.T
        return sums.reshape(m, runs, -1).transpose(1, 2, 0)
    blocks = matrix.shape[1] // slots
    together = values.reshape(blocks, runs // blocks, slots, m).transpose(0, 2, 3, 1)
    sums = (matrix @ together.reshape(blocks * slots, -1)).reshape(blocks, -1, m, runs // blocks)
    apart = sums.transpose(2, 0, 3, 1).reshape(m, runs, -1)
    return np.ascontiguousarray(apart).transpose(1, 2, 0)
