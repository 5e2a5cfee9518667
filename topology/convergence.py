"""How fast disagreement falls, predicted and measured, on links that stay, fail or take turns.

With intermittent links a round multiplies by a random matrix W(t). Node i adds w_ij (x_j - x_i) for
every link that is up; the weight of each other link stays with the node's own value. The rows of W
sum to 1, so with P = I - 11'/n the disagreement P x becomes P W P x. Its second moments evolve
linearly by E[P W (x) P W] (Kushner 1971; for averaging: Boyd, Ghosh, Prabhakar, Shah 2006, section
II). The root of the spectral radius is the factor per round of the root mean square disagreement.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, eigs

from concord.topology.adjacency import entries, links_of, nodes_of
from concord.topology.spectrum import second_eigenvalue_modulus

# The operator on second moments has so many squared entries to a vector.
MOST_MOMENT_NODES = 300
_BATCHES = 20
# Student's t for 19 degrees of freedom, two-sided 95 %.
_T_95 = 2.093


class LinkModel(NamedTuple):
    """The links of weights (n, n) and how they fare.

    Attributes:
        hearer, heard: (links,), in the order of `links_of`.
        weight: (links,).
        delivery: (links,), the chance that a link is up in a round, independently of the rounds
            before.
        pair: (links,), equal numbers for links that are up or down together.
    """

    nodes: int
    hearer: NDArray[np.intp]
    heard: NDArray[np.intp]
    weight: np.ndarray
    delivery: np.ndarray
    pair: NDArray[np.intp]


class MeasuredRate(NamedTuple):
    """A factor per round and its 95 % interval; `rounds` and `runs` it was measured on."""

    factor: float
    low: float
    high: float
    rounds: int
    runs: int


def links_with(
    weights: csr_array, delivery: np.ndarray | float, *, together: bool = False
) -> LinkModel:
    """The links of weights (n, n) that are up with chance `delivery` (links,), both directions of a
    pair at once if they fail `together`."""
    hearer, heard = links_of(weights)
    between = hearer != heard
    hearer, heard = hearer[between], heard[between]
    nodes = nodes_of(weights)
    chances = np.broadcast_to(np.asarray(delivery, dtype=float), hearer.shape)
    codes = np.minimum(hearer, heard) * nodes + np.maximum(hearer, heard)
    pair = np.unique(codes, return_inverse=True)[1] if together else np.arange(len(hearer))
    return LinkModel(nodes, hearer, heard, entries(weights, hearer, heard), chances, pair)


def mean_square_factor(links: LinkModel) -> float:
    """The factor per round by which the root mean square of disagreement falls in the long run.

    Raises:
        ValueError: more than `MOST_MOMENT_NODES` nodes; `mean_square_bound` has no such limit.
    """
    n = links.nodes
    if n > MOST_MOMENT_NODES:
        raise ValueError(
            f"second moments of {n} nodes are {n * n} numbers; at most {MOST_MOMENT_NODES} nodes"
        )
    if n == 1:
        return 0.0
    mean = _mean_weights(links)

    def carried(flat: np.ndarray) -> np.ndarray:
        moments = _centred(flat.reshape(n, n))
        return _centred(mean @ (mean @ moments).T + _spread(links, moments)).ravel()

    if n <= 3:
        basis = np.stack([carried(unit) for unit in np.eye(n * n)], axis=1)
        return math.sqrt(float(np.abs(np.linalg.eigvals(basis)).max()))
    operator = LinearOperator((n * n, n * n), matvec=carried, dtype=float)  # type: ignore[call-arg]
    start = _centred(np.eye(n)).ravel()
    found = eigs(operator, k=1, v0=start, tol=1e-9, return_eigenvectors=False)  # type: ignore[arg-type]
    return math.sqrt(float(np.abs(found).max()))  # type: ignore[arg-type]


def mean_square_bound(links: LinkModel) -> float:
    """The most that a round leaves of a disagreement, root mean square: the root of the norm of
    E[W' P W], which bounds `mean_square_factor` from above."""
    mean = _mean_weights(links)
    n = links.nodes
    first = np.unique(links.pair, return_index=True)[1]
    alone = np.bincount(links.pair, weights=links.weight**2)[links.pair]
    difference = np.bincount(links.pair, weights=_signed(links))[links.pair]
    strength = links.delivery * (1 - links.delivery) * (alone - difference**2 / n)

    def squared(values: np.ndarray) -> np.ndarray:
        values = values - values.mean()
        moved = mean @ values
        gap = (strength * (values[links.heard] - values[links.hearer]))[first]
        spread = np.bincount(links.heard[first], gap, n) - np.bincount(links.hearer[first], gap, n)
        result = mean.T @ (moved - moved.mean()) + spread
        return result - result.mean()

    operator = LinearOperator((n, n), matvec=squared, dtype=float)  # type: ignore[call-arg]
    start = np.random.default_rng(n).normal(size=n)
    found = eigs(operator, k=1, v0=start, return_eigenvectors=False)  # type: ignore[arg-type]
    return math.sqrt(float(np.abs(found).max()))  # type: ignore[arg-type]


def cycle_factor(phases: list[csr_array]) -> float:
    """The factor per round of weights (n, n) that follow each other and begin again: the root of
    the second eigenvalue modulus of their product."""
    product = np.eye(nodes_of(phases[0]))
    for weights in phases:
        product = weights @ product
    return second_eigenvalue_modulus(product) ** (1 / len(phases))


def rounds_to_settle(factor: float, most: int) -> int:
    """Rounds after which the slowest mode of a network that leaves `factor` per round stands alone,
    and as many to measure it on."""
    return int(np.clip(math.ceil(30 / max(1 - factor, 1e-9)), 60, most))


def measured_factor(
    one_round: Callable[[np.ndarray, int], np.ndarray],
    nodes: int,
    runs: int,
    rounds: int,
    generator: np.random.Generator,
    redrawn: Callable[[NDArray[np.intp]], None] = lambda chosen: None,
) -> MeasuredRate:
    """Return the factor per round, measured by carrying out an averaging.

    `one_round(values (n, runs), round)` is the averaging. The runs begin at random values and take
    `rounds` rounds, of which the second half counts. When the runs have grown unlike, they are
    drawn again in proportion to their mean square, so that a few runs do not dominate. `redrawn`
    receives their indices (runs,), for averagings that keep a state for each run.
    """
    values = generator.normal(size=(nodes, runs))
    growth = np.empty(rounds)
    weight = np.full(runs, 1 / runs)
    values = _of_unit_size(values)
    for number in range(rounds):
        values = one_round(values, number)
        values = values - values.mean(axis=0)
        size = (values**2).sum(axis=0)
        growth[number] = weight @ size
        if not growth[number] > 1e-300:
            return MeasuredRate(0.0, 0.0, 0.0, number + 1, runs)
        weight = weight * size / growth[number]
        values = _of_unit_size(values)
        if 1 / (weight**2).sum() < runs / 2:
            chosen = _systematic(weight, generator)
            redrawn(chosen)
            values = values[:, chosen]
            weight = np.full(runs, 1 / runs)
    rates = np.log(growth[rounds // 2 :]) / 2
    means = np.array([batch.mean() for batch in np.array_split(rates, _BATCHES)])
    middle = float(rates.mean())
    half = _T_95 * float(means.std(ddof=1)) / math.sqrt(_BATCHES)
    low, high = math.exp(middle - half), math.exp(middle + half)
    return MeasuredRate(math.exp(middle), low, high, rounds, runs)


class MarkovLinks:
    """Rounds of averaging on links that are Markov chains, in equilibrium at the start.

    Both ends of a link share its state; each run has states of its own, which follow it when runs
    are drawn anew.
    """

    def __init__(
        self,
        links: LinkModel,
        failure: float,
        repair: float,
        runs: int,
        generator: np.random.Generator,
    ) -> None:
        self._links, self._failure, self._repair = links, failure, repair
        self._generator = generator
        self._gather = _gather(links)
        pairs = int(links.pair.max(initial=-1)) + 1
        self._up = generator.random((pairs, runs)) < repair / (failure + repair)

    def one_round(self, values: np.ndarray, number: int) -> np.ndarray:
        """Values (n, runs) after the links have moved on and all have averaged."""
        drawn = self._generator.random(self._up.shape)
        self._up = np.where(self._up, drawn >= self._failure, drawn < self._repair)
        heard, hearer = values[self._links.heard], values[self._links.hearer]
        return values + self._gather @ ((heard - hearer) * self._up[self._links.pair])

    def redrawn(self, chosen: NDArray[np.intp]) -> None:
        """The links go with their runs."""
        self._up = self._up[:, chosen]


def averaging(
    links: LinkModel, generator: np.random.Generator
) -> Callable[[np.ndarray, int], np.ndarray]:
    """Rounds of averaging in which links come and go, for `measured_factor`."""
    pairs = int(links.pair.max(initial=-1)) + 1
    gather = _gather(links)

    def one_round(values: np.ndarray, number: int) -> np.ndarray:
        draws = generator.random((pairs, values.shape[1]))[links.pair]
        heard = (values[links.heard] - values[links.hearer]) * (draws < links.delivery[:, None])
        return values + gather @ heard

    return one_round


def _gather(links: LinkModel) -> csr_array:
    """Return the matrix (n, links) that adds the value of each link at its receiver."""
    place = (links.hearer, np.arange(len(links.hearer)))
    return csr_array((links.weight, place), shape=(links.nodes, len(links.hearer)))


def _mean_weights(links: LinkModel) -> csr_array:
    """E[W] (n, n)."""
    weight = links.weight * links.delivery
    own = 1 - np.bincount(links.hearer, weight, links.nodes)
    everyone = np.arange(links.nodes)
    place = (np.append(links.hearer, everyone), np.append(links.heard, everyone))
    return csr_array((np.append(weight, own), place), shape=(links.nodes, links.nodes))


def _spread(links: LinkModel, moments: np.ndarray) -> np.ndarray:
    """E[(W - E[W]) X (W - E[W])'] (n, n) of symmetric X (n, n): links that fail together move both
    ends at once, by (x_j - x_i) times w_ij and -w_ji."""
    i, j = links.hearer, links.heard
    diagonal = moments.diagonal()
    gap = diagonal[i] + diagonal[j] - moments[i, j] - moments[j, i]
    strength = links.delivery * (1 - links.delivery) * gap
    result: np.ndarray = np.diag(np.bincount(i, strength * links.weight**2, links.nodes)).astype(
        float
    )
    partner = _partner(links)
    twin = partner >= 0
    np.add.at(
        result,
        (i[twin], j[twin]),
        -(strength * links.weight)[twin] * links.weight[partner[twin]],
    )
    return result


def _partner(links: LinkModel) -> NDArray[np.intp]:
    """Return the link (links,) that is up and down with this one, -1 for none."""
    order = np.argsort(links.pair, kind="stable")
    same = np.flatnonzero(np.diff(links.pair[order]) == 0)
    partner = np.full(len(links.pair), -1)
    partner[order[same]] = order[same + 1]
    partner[order[same + 1]] = order[same]
    return partner


def _signed(links: LinkModel) -> np.ndarray:
    """Weights, those of the lower end of a pair as they are and of the higher with a minus."""
    return np.where(links.hearer < links.heard, links.weight, -links.weight)


def _centred(moments: np.ndarray) -> np.ndarray:
    moments = moments - moments.mean(axis=0)
    return moments - moments.mean(axis=1, keepdims=True)


def _of_unit_size(values: np.ndarray) -> np.ndarray:
    values = values - values.mean(axis=0)
    size = np.sqrt((values**2).sum(axis=0))
    return values / np.where(size > 0, size, 1.0)


def _systematic(weight: np.ndarray, generator: np.random.Generator) -> NDArray[np.intp]:
    """Indices (runs,) drawn by weight (runs,) with one random number (Kitagawa 1996)."""
    runs = len(weight)
    points = (np.arange(runs) + generator.random()) / runs
    return np.minimum(np.searchsorted(np.cumsum(weight), points), runs - 1)
