"""Local filters in arrays (runs, nodes, ...), before any share is heard, and their counters."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from concord.filters.filter import Filter, LearningFilter
from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.links import Links
from concord.nodes.rules.lane_rule import FIRST_BID, bid_for_change, mapped
from concord.nodes.rules.local_filter import LocalFilters, Memory, where

Counters = Mapping[str, np.ndarray]
"""Totals (R, N) since the start by the names that `concord.nodes.node` and the rules give them."""


def added(counters: Counters, more: Mapping[str, np.ndarray]) -> Counters:
    """The counters with more (R, N) added, name by name; what never happened has no name."""
    happened = {name: count.astype(np.int64) for name, count in more.items() if count.any()}
    return {**counters, **{name: counters.get(name, 0) + n for name, n in happened.items()}}


def traffic(
    links: Links, good: np.ndarray, bad: np.ndarray, lost: np.ndarray | None, reason: str
) -> dict[str, np.ndarray]:
    """Return each node's counters of a cycle in which nodes (R, N) sent `good` or `bad` shares.

    Receivers reject the `bad` ones for that `reason`. `lost` (R, E) is as in `Links.arriving`.
    """
    if lost is None and good.all():
        return {"heard": np.broadcast_to(np.diff(links.offsets), good.shape)}
    heard, rejected = (links.per_receiver(links.arriving(sent, lost)) for sent in (good, bad))
    due = links.per_receiver((good | bad)[:, links.sender])
    counts = {"heard": heard, f"rejected {reason}": rejected, "missed": due - heard}
    if lost is not None:
        counts["lost"] = links.per_receiver(np.where((good | bad)[:, links.sender], lost, 0))
    return counts


def received(values: np.ndarray, number: str) -> np.ndarray:
    """Numbers as they come out of a share that writes them as `number`, "<f8" or "<f4"."""
    return values if number == "<f8" else values.astype(number).astype(np.float64)


def with_lanes(beliefs: Gaussian, nodes: np.ndarray, others: Gaussian) -> Gaussian:
    """Beliefs (R, N, n), of nodes (J,) those others (R, J, n)."""
    mean, cov = beliefs.mean.copy(), beliefs.cov.copy()
    mean[:, nodes], cov[:, nodes] = others
    return Gaussian(mean, cov)


def forgotten(
    filters: LocalFilters, memory: tuple[Memory | None, ...], nodes: np.ndarray, count: int
) -> tuple[Memory | None, ...]:
    """Return the memory of each group of sensors after some `nodes` (J,) of so many begin anew."""
    anew = np.isin(np.arange(count), nodes)
    pairs = zip(filters.groups, memory, strict=True) if memory else ()
    return tuple(
        None if known is None else _begun_anew(filters.filter, known, anew[group.nodes])
        for group, known in pairs
    )


def _begun_anew(filter: Filter, known: Memory, anew: np.ndarray) -> Memory:
    """The memory (R, K, ...) of a group in which nodes `anew` (K,) begin anew."""
    assert isinstance(filter, LearningFilter), "only this kind of filter has a memory"

    def chosen(old: np.ndarray, new: np.ndarray) -> np.ndarray:
        return np.where(anew.reshape(-1, *(1,) * (old.ndim - 2)), new, old)

    return known._replace(learnt=mapped(chosen, known.learnt, filter.begin(known.shape)))


class LastPublished(NamedTuple):
    """Last published beliefs of the nodes that may contend, `nodes` (C,): (R, C, n), (..., n).

    `known` (R, C) is False where they never did, or what they sent could not be carried on.
    """

    nodes: np.ndarray
    belief: Gaussian
    known: np.ndarray

    def carried(
        self, filters: LocalFilters, control: np.ndarray | None, step: int
    ) -> "LastPublished":
        """The same at `step`."""
        if not self.known.any():
            return self
        belief, sound = filters.predict(self.belief, control, step)
        return self._replace(belief=belief, known=self.known & sound)

    def forgotten(self, nodes: np.ndarray) -> "LastPublished":
        """After nodes (J,) have begun anew."""
        return self._replace(known=self.known & ~np.isin(self.nodes, nodes))

    def sent(self, belief: Gaussian, sends: np.ndarray) -> "LastPublished":
        """After nodes `sends` (R, N) have sent their beliefs (R, N, n)."""
        if not len(self.nodes):
            return self
        now = Gaussian(belief.mean[:, self.nodes], belief.cov[:, self.nodes])
        speaks = sends[:, self.nodes]
        return self._replace(belief=where(speaks, now, self.belief), known=self.known | speaks)

    def bids_of(self, some: np.ndarray, belief: Gaussian, trigger: float) -> np.ndarray:
        """How urgently some of the nodes (J,) ask now that all believe this: integers (R, J)."""
        places = np.searchsorted(self.nodes, some)
        now = Gaussian(belief.mean[:, some], belief.cov[:, some])
        then = Gaussian(self.belief.mean[:, places], self.belief.cov[:, places])
        return np.where(self.known[:, places], bid_for_change(now, then, trigger), FIRST_BID)


def nothing_published(nodes: np.ndarray, prior: Gaussian) -> LastPublished:
    """Return the start, before any of `nodes` (C,) has sent; priors (R, N, n) fill the places."""
    belief = Gaussian(prior.mean[:, nodes], prior.cov[:, nodes])
    return LastPublished(nodes, belief, np.zeros(belief.mean.shape[:2], dtype=bool))
