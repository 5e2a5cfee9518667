"""The links of a network as one list, and sums along it: cost grows with links, not with pairs.

Arrays over links are sorted by receiver, then by sender, as a node's neighbours are. Rules that
look at one node's neighbourhood as an array (..., J) are served class by class. Nodes with about as
many neighbours are stacked; missing places are padded with shares that were never heard.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import chain
from typing import NamedTuple

import numpy as np

# Of the places of a class, at least this share must be links.
_FULLNESS = 0.6


class DegreeClass(NamedTuple):
    """Nodes (K,) of about as many neighbours; links (K, J) of theirs, `real` (K, J) says which are
    not filled up."""

    nodes: np.ndarray
    links: np.ndarray
    real: np.ndarray

    def gathered(self, values: np.ndarray, missing: float) -> np.ndarray:
        """Values (R, E, ...) of links as (R, K, J, ...), `missing` where there is none."""
        found = values[:, self.links]
        if self.real.all():
            return found
        shape = (1, *self.real.shape, *(1,) * (values.ndim - 2))
        return np.where(self.real.reshape(shape), found, missing)


class Links(NamedTuple):
    """All links of a network of `nodes`: `receiver` and `sender` (E,), `offsets` (N + 1,) of each
    receiver's first.

    Held shares are kept in slots: `slot` (E,) is the one that a link reads, `source` (K,) the node
    that a slot belongs to. Where no frame is lost, all nodes that hear a node hold the same share
    of it, and a slot is a node; else it is a link.
    """

    nodes: int
    receiver: np.ndarray
    sender: np.ndarray
    offsets: np.ndarray
    slot: np.ndarray
    source: np.ndarray
    classes: tuple[DegreeClass, ...]

    @property
    def perfect(self) -> bool:
        """Whether a slot is a node."""
        return len(self.source) == self.nodes and (self.source == np.arange(self.nodes)).all()

    def arriving(self, sent: np.ndarray, lost: np.ndarray | None) -> np.ndarray:
        """Which links (R, E) bring a share of those that `sent` (R, N) one; `lost` frames (R, E)
        are those that a link loses of a share."""
        brought = sent[:, self.sender]
        return brought if lost is None else brought & (lost == 0)

    def in_slots(self, sent: np.ndarray, lost: np.ndarray | None) -> np.ndarray:
        """Which slots (R, K) are filled by those."""
        return sent[:, self.source] if self.perfect else self.arriving(sent, lost)

    def rows(self, values: "Shares") -> Iterator[np.ndarray]:
        """Values of nodes and links for each class: (R, K, 1 + J), 0 where there is no link."""
        for some in self.classes:
            yield _with_own(values.own[:, some.nodes, None], some.gathered(values.link, 0.0))

    def per_receiver(self, flags: np.ndarray) -> np.ndarray:
        """Sums (R, N) over each node's links of flags or counts (R, E)."""
        before = np.zeros((len(flags), flags.shape[1] + 1), dtype=np.int64)
        np.cumsum(flags, axis=1, out=before[:, 1:])
        return before[:, self.offsets[1:]] - before[:, self.offsets[:-1]]


@lru_cache(maxsize=64)
def places(nodes: tuple[int, ...]) -> np.ndarray:
    """Nodes as an index; kept, as schedules name the same ones in every cycle."""
    found = np.array(nodes, dtype=np.int64)
    found.setflags(write=False)
    return found


def unheard(links: Links, ages: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Ages (R, E) or (1, E) of what came over links, of which nodes (J,) have never heard one."""
    return np.where(np.isin(links.receiver, nodes), -1, ages)


class Shares(NamedTuple):
    """A weight for each node's own numbers (R, N), and for those of each link (R, E)."""

    own: np.ndarray
    link: np.ndarray


class Padded(NamedTuple):
    """Some links for each of K nodes or links, (K, J), filled up; `real` (K, J) says which are."""

    links: np.ndarray
    real: np.ndarray


def neighbourhoods(links: Links) -> Padded:
    """The links of each node."""
    degrees = np.diff(links.offsets)
    real = np.arange(max(int(degrees.max(initial=0)), 1)) < degrees[:, None]
    return Padded(np.where(real, links.offsets[:-1, None] + np.arange(real.shape[1]), 0), real)


def overhearing(links: Links) -> Padded:
    """For each link, those of its receiver to the sender and to its other hearers."""
    hears = np.eye(links.nodes, dtype=bool)
    hears[links.receiver, links.sender] = True
    near, real = (one[links.receiver] for one in neighbourhoods(links))
    return Padded(near, real & hears[links.sender[near], links.sender[:, None]])


def links_of(neighbours: Sequence[Sequence[int]], perfect: bool) -> Links:
    """The links of a network in which node i hears neighbours[i]; perfect ones lose nothing."""
    degrees = np.array([len(heard) for heard in neighbours])
    offsets = np.concatenate(([0], np.cumsum(degrees)))
    sender = np.fromiter(chain.from_iterable(neighbours), np.int64, int(offsets[-1]))
    receiver = np.repeat(np.arange(len(neighbours)), degrees)
    classes = tuple(
        _degree_class(np.sort(nodes), offsets, degrees) for nodes in _alike_in_degree(degrees)
    )
    slots = (sender, np.arange(len(neighbours))) if perfect else (np.arange(len(sender)), sender)
    return Links(len(neighbours), receiver, sender, offsets, *slots, classes)


def _alike_in_degree(degrees: np.ndarray) -> Iterator[np.ndarray]:
    """Nodes cut into classes, each as large as fullness allows."""
    order = np.argsort(-degrees, kind="stable")
    start = 0
    while start < len(order):
        wanted = _FULLNESS * (1 + degrees[order[start]])
        filled = np.cumsum(1 + degrees[order[start:]]) / np.arange(1, len(order) - start + 1)
        # The mean degree only falls, so the last place where it is enough ends the class.
        count = int(np.flatnonzero(filled >= wanted)[-1]) + 1
        yield order[start : start + count]
        start += count


def _degree_class(nodes: np.ndarray, offsets: np.ndarray, degrees: np.ndarray) -> DegreeClass:
    most = int(degrees[nodes].max())
    real = np.arange(most) < degrees[nodes][:, None]
    links = np.where(real, offsets[nodes][:, None] + np.arange(most), 0)
    return DegreeClass(nodes, links, real)


def _with_own(own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Own (R or 1, ...) and others' (R, K, J) values as (R, K, 1 + J)."""
    first = np.broadcast_to(own, (*others.shape[:-1], 1))
    return np.concatenate((first, others), axis=-1)
