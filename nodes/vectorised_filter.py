"""What every rule does in arrays (runs, nodes, ...) before anybody is heard, and what it counts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule
from nodes.bids import FIRST_BID, bid_for_change
from nodes.local_filter import Model, Sensor, carry, take_readings, where
from nodes.messages import Array
from nodes.vectorised_links import Links

Counters = Mapping[str, np.ndarray]
"""Totals (R, N) since the start by the names that `nodes.state_machine` and the rules give them."""


class SensorGroup(NamedTuple):
    """Nodes (an index into their axis) that one sensor value serves: its arrays have their axis."""

    nodes: slice | np.ndarray
    sensor: Sensor


@dataclass(frozen=True)
class LocalFilters:
    """What the nodes believe of plant and sensors; nodes in no group are blind."""

    model: Model
    groups: tuple[SensorGroup, ...]
    points: SigmaPointRule

    def carry(
        self, belief: Gaussian, control: Array | None, step: int
    ) -> tuple[Gaussian, np.ndarray]:
        """Beliefs (R, N, n) of the step before at `step`, and where that went well (R, N)."""
        driven = None if control is None else control[:, None, :]
        moved, sound = carry(belief, driven, step, self.model, self.points)
        return where(sound, moved, belief), sound

    def take(
        self, belief: Gaussian, readings: Array, step: int
    ) -> tuple[Gaussian, dict[str, np.ndarray]]:
        """Beliefs (R, N, n) after each node's own readings (R, N, r, d), and what went wrong."""
        if len(self.groups) == 1 and self.groups[0].nodes == slice(None):
            sensor = self.groups[0].sensor
            return take_readings(belief, readings, step, sensor, self.points)
        mean, cov = belief.mean.copy(), belief.cov.copy()
        counted: dict[str, np.ndarray] = {}
        for nodes, sensor in self.groups:
            own = Gaussian(belief.mean[:, nodes], belief.cov[:, nodes])
            after, troubles = take_readings(own, readings[:, nodes], step, sensor, self.points)
            mean[:, nodes], cov[:, nodes] = after
            for name, count in troubles.items():
                total = counted.setdefault(name, np.zeros(mean.shape[:2], dtype=int))
                total[:, nodes] += count
        return Gaussian(mean, cov), counted


def added(counters: Counters, more: Mapping[str, np.ndarray]) -> Counters:
    """The counters with more (R, N) added, name by name; what never happened has no name."""
    happened = {name: count.astype(np.int64) for name, count in more.items() if count.any()}
    return {**counters, **{name: counters.get(name, 0) + n for name, n in happened.items()}}


def traffic(
    links: Links, good: np.ndarray, bad: np.ndarray, lost: np.ndarray | None, reason: str
) -> dict[str, np.ndarray]:
    """What each node counts of a cycle in which nodes (R, N) sent `good` shares, or `bad` ones that
    are rejected for that `reason`; `lost` (R, E) as `Links.arriving` has it."""
    if lost is None and good.all():
        return {"heard": np.broadcast_to(np.diff(links.offsets), good.shape)}
    heard, rejected = (links.per_receiver(links.arriving(sent, lost)) for sent in (good, bad))
    due = links.per_receiver((good | bad)[:, links.sender])
    counts = {"heard": heard, f"rejected {reason}": rejected, "missed": due - heard}
    if lost is not None:
        counts["lost"] = links.per_receiver(np.where((good | bad)[:, links.sender], lost, 0))
    return counts


def received(values: Array, number: str) -> Array:
    """Numbers as they come out of a share that writes them as `number`, "<f8" or "<f4"."""
    return values if number == "<f8" else values.astype(number).astype(np.float64)


def with_lanes(beliefs: Gaussian, nodes: np.ndarray, others: Gaussian) -> Gaussian:
    """Beliefs (R, N, n), of nodes (J,) those others (R, J, n)."""
    mean, cov = beliefs.mean.copy(), beliefs.cov.copy()
    mean[:, nodes], cov[:, nodes] = others
    return Gaussian(mean, cov)


class Published(NamedTuple):
    """What those who may contend (`nodes` (C,)) believed when they last sent: (R, C, n), (..., n).

    `known` (R, C) is False where they never did, or what they sent could not be carried on.
    """

    nodes: np.ndarray
    belief: Gaussian
    known: np.ndarray

    def carried(self, filters: LocalFilters, control: Array | None, step: int) -> "Published":
        """The same at `step`."""
        if not self.known.any():
            return self
        belief, sound = filters.carry(self.belief, control, step)
        return self._replace(belief=belief, known=self.known & sound)

    def forgotten(self, nodes: np.ndarray) -> "Published":
        """After nodes (J,) have begun anew."""
        return self._replace(known=self.known & ~np.isin(self.nodes, nodes))

    def sent(self, belief: Gaussian, sends: np.ndarray) -> "Published":
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


def nothing_published(nodes: np.ndarray, prior: Gaussian) -> Published:
    """Before anybody of `nodes` (C,) has sent; priors (R, N, n) fill the places."""
    belief = Gaussian(prior.mean[:, nodes], prior.cov[:, nodes])
    return Published(nodes, belief, np.zeros(belief.mean.shape[:2], dtype=bool))
