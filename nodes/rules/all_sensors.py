"""The sensors of all nodes as one: what each node reads of a state, on an axis of the nodes."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.rules.local_filter import Sensor, SensorGroup, StateNoise


@runtime_checkable
class SensorOfEach(Protocol):
    """A sensor of many nodes that can be that of single ones."""

    def for_node(self, node: np.ndarray, /) -> Sensor:
        """Return the sensor of these nodes (...), which takes states (..., n)."""
        ...


class _Alike(NamedTuple):
    """Nodes with one sensor value; `size` numbers are in one reading of theirs.

    `of_each` is the sensor if it can be that of single nodes. `state_noise` is the sensor if its
    noise depends on the state.
    """

    sensor: Sensor
    of_each: SensorOfEach | None
    state_noise: StateNoise | None
    nodes: np.ndarray
    size: int


class _Entries(NamedTuple):
    """Entries (L, K) whose sources are alike: their index, lanes, and places in the group.

    `sensor` is that of the places, or None where only that of all nodes is known.
    """

    alike: _Alike
    at: tuple[Any, ...]
    lanes: Any
    places: Any
    sensor: Sensor | None


@dataclass(frozen=True)
class AllSensors:
    """Sensors of `nodes` nodes in groups; each delivers readings of shape (r, d).

    A reading is m numbers, as many as the largest has. A smaller reading ends with NaN.
    """

    groups: tuple[SensorGroup, ...]
    nodes: int
    delivered: tuple[int, int]

    @cached_property
    def size(self) -> int:
        """The most numbers m of a reading."""
        return max((alike.size for alike in self._alike), default=1)

    @cached_property
    def _alike(self) -> tuple[_Alike, ...]:
        found = []
        for index, sensor in self.groups:
            nodes = np.arange(self.nodes)[index]
            nothing = np.full((len(nodes), self.delivered[1]), np.nan)
            size = sensor.interpret(nothing)[0].shape[-1]
            of_each = sensor if isinstance(sensor, SensorOfEach) else None
            state_noise = sensor if isinstance(sensor, StateNoise) else None
            found.append(_Alike(sensor, of_each, state_noise, nodes, size))
        return tuple(found)

    @cached_property
    def _group_and_place(self) -> tuple[np.ndarray, np.ndarray]:
        """The number of each node's group, -1 for a blind node, and its place in the group (N,)."""
        group, place = np.full(self.nodes, -1), np.zeros(self.nodes, dtype=int)
        for number, alike in enumerate(self._alike):
            group[alike.nodes] = number
            place[alike.nodes] = np.arange(len(alike.nodes))
        return group, place

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (..., N, r, m) and noise covariances (..., N, r, m, m) of (..., N, r, d)."""
        shape = (*delivered.shape[:-1], self.size)
        values, covs = np.full(shape, np.nan), np.zeros((*shape, self.size))
        covs[...] = np.eye(self.size)
        for (index, sensor), (*_, size) in zip(self.groups, self._alike, strict=True):
            for place in range(delivered.shape[-2]):
                value, cov = sensor.interpret(delivered[..., index, place, :])
                values[..., index, place, :size] = value
                covs[..., index, place, :size, :size] = cov
        return values, covs

    def of(self, sources: np.ndarray) -> "SourceSensors":
        """Return the sensors of K readings in each of L lanes, which these sources (L, K) took."""
        group, place = self._group_and_place
        everywhere = slice(None), slice(None)
        lanes = np.arange(len(sources))[:, None]
        if len(self.groups) == 1 and self.groups[0].whole:
            entries = (_entries(self._alike[0], everywhere, lanes, sources),)
            return SourceSensors(entries, sources.shape, self.size)
        groups, found = group[sources], []
        for number in sorted({*groups.ravel().tolist()} - {-1}):
            at: tuple[Any, ...] = np.nonzero(groups == number)
            if len(at[0]) == 1:
                # An index of integers is much faster than one of arrays.
                at = int(at[0][0]), int(at[1][0])
            places = place[sources[at]]
            found.append(_entries(self._alike[number], at, at[0], places))
        return SourceSensors(tuple(found), sources.shape, self.size)


def _entries(alike: _Alike, at: tuple[Any, ...], lanes: Any, places: Any) -> _Entries:
    several = alike.of_each if len(alike.nodes) > 1 else None
    sensor = None if several is None else several.for_node(places)
    return _Entries(alike, at, lanes, places, sensor)


@dataclass(frozen=True)
class SourceSensors:
    """The sensors of K readings of m = `size` numbers in each of L lanes; `shape` is (L, K)."""

    entries: tuple[_Entries, ...]
    shape: tuple[int, ...]
    size: int

    def measure(self, states: np.ndarray, step: int) -> np.ndarray:
        """Return the readings (..., L, K, m) at states (..., L, n)."""
        *before, lanes, n = states.shape
        found = np.zeros((*before, *self.shape, self.size))
        for (sensor, *_, nodes, size), at, where, places, of_places in self.entries:
            if of_places is not None:
                found[..., *at, :size] = of_places.measure(states[..., where, :], step)
                continue
            there = states[..., None, :]
            if len(nodes) > 1:
                there = np.broadcast_to(there, (*before, lanes, len(nodes), n))
            read = sensor.measure(there, step)
            found[..., *at, :size] = read[..., where, places, :]
        return found

    def residual(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Return the differences of readings (..., L, K, m), angles wrapped."""
        found = one - other
        for (sensor, *_, size), at, *_ in self.entries:
            entries = (..., *at, slice(size))
            found[entries] = sensor.residual(one[entries], other[entries])
        return found

    def state_noise(self, belief: Gaussian, step: int) -> np.ndarray | None:
        """Return what the noise (L, K, m, m) grows by at beliefs (L, n); None for nothing."""
        if not any(entries.alike.state_noise for entries in self.entries):
            return None
        more = np.zeros((*self.shape, self.size, self.size))
        there = Gaussian(belief.mean[:, None], belief.cov[:, None])
        for (*_, state_noise, nodes, size), at, where, places, _ in self.entries:
            if state_noise is not None:
                cov = state_noise.state_noise_cov(there, step)
                cov = np.broadcast_to(cov, (self.shape[0], len(nodes), size, size))
                more[*at, :size, :size] = cov[where, places]
        return more
