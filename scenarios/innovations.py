"""Innovations: readings minus their predictions, of each node and of the filter that hears all.

A node's innovations are those of its own readings. The prediction is the node's estimate after the
step before, carried to this step, with the readings that the node took before in the same step.
That holds for every rule: rules that take the readings of neighbours judge an own reading by what
the node knew before the step.

They are computed from the recorded estimates and readings, by the functions that the nodes call. So
no message carries them, and every driver has the same. A node has none in the step in which it
returns, since the belief with which it returns is not its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.filters.filter import begun, moments
from concord.filters.gaussian import Gaussian
from concord.nodes.rules.all_sensors import AllSensors
from concord.nodes.rules.local_filter import (
    LocalFilters,
    Memory,
    Sensor,
    finite_lanes,
    update_and_learn,
    where,
)
from concord.scenarios.baselines import driven_into, priors_of_runs
from concord.scenarios.build import filter_of
from concord.scenarios.catalogue import definition_of
from concord.scenarios.moves import with_scripted_moves
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.setup import Setup


class Innovations(NamedTuple):
    """Innovations of readings of at most m entries; NaN where nothing was taken.

    Attributes:
        value: (..., N, r, m), reading minus prediction.
        cov: (..., N, r, m, m), its covariance.
        nis: (..., N, r), normalised innovation squared. With a matched filter it is chi-square with
            as many degrees of freedom as entries were taken.
    """

    value: np.ndarray
    cov: np.ndarray
    nis: np.ndarray

    @property
    def entries(self) -> np.ndarray:
        """How many entries of a reading were taken, integers (..., N, r)."""
        return np.isfinite(self.value).sum(axis=-1)


class HearsAll(NamedTuple):
    """The filter that hears everything: its beliefs (..., n), and the innovations of all nodes'
    readings, taken one by one in the order of the nodes."""

    belief: Gaussian
    innovations: Innovations


Learnt = tuple[Memory | None, ...]
"""Memories of a filter that learns the noise of sensors, one for each; empty before the start."""


@dataclass(frozen=True)
class InnovationFilters:
    """The filters of a network, step by step, that tell their innovations.

    `sensors` are those of the nodes that have one; `size` is the most entries m of a reading.
    """

    filters: LocalFilters
    sensors: tuple[tuple[int, Sensor], ...]
    size: int

    def of_nodes(
        self,
        before: Gaussian,
        readings: np.ndarray,
        control: np.ndarray | None,
        step: int,
        learnt: Learnt,
    ) -> tuple[Innovations, Learnt]:
        """Innovations (R, N, r, m) of own readings (R, N, r, d) at a step.

        `before` (R, N, n) are the nodes' estimates of the step before, or their priors at step 0;
        control (R, p) drove the plant into the step.
        """
        belief = begun(self.filters.filter, before)
        if step > 0:
            belief, _ = self.filters.predict(belief, control, step)
        found, memories = self._nothing(readings), []
        groups = self.filters.groups
        for group, memory in zip(groups, learnt or (None,) * len(groups), strict=True):
            own = Gaussian(group.of(belief.mean), group.of(belief.cov))
            _, taken, memory = self._taken(own, group.of(readings), group.sensor, step, memory)
            _put(found, group.nodes, taken)
            memories.append(memory)
        return found, tuple(memories)

    def of_all(
        self,
        before: Gaussian,
        readings: np.ndarray,
        control: np.ndarray | None,
        step: int,
        learnt: Learnt,
    ) -> tuple[HearsAll, Learnt]:
        """The filter that hears everything, from its beliefs (R, n) of the step before."""
        belief, found, memories = before, self._nothing(readings), []
        if step > 0:
            lanes = Gaussian(before.mean[:, None], before.cov[:, None])
            moved, _ = self.filters.predict(lanes, control, step)
            belief = Gaussian(moved.mean[:, 0], moved.cov[:, 0])
        known = learnt or (None,) * len(self.sensors)
        for (node, sensor), memory in zip(self.sensors, known, strict=True):
            belief, taken, memory = self._taken(belief, readings[:, node], sensor, step, memory)
            _put(found, node, taken)
            memories.append(memory)
        return HearsAll(belief, found), tuple(memories)

    def _taken(
        self,
        belief: Gaussian,
        readings: np.ndarray,
        sensor: Sensor,
        step: int,
        memory: Memory | None,
    ) -> tuple[Gaussian, Innovations, Memory | None]:
        """Beliefs (..., n) after readings (..., r, d), one by one, the innovations, and the
        memory."""
        found = self._nothing(readings)
        for place in range(readings.shape[-2]):
            delivered = readings[..., place, :]
            if np.isnan(delivered).all():
                continue
            interpreted = sensor.interpret(delivered)
            result, memory = update_and_learn(
                belief, memory, interpreted, step, sensor, self.filters.filter
            )
            taken = np.isfinite(interpreted[0]).any(axis=-1)
            size = result.innovation.shape[-1]
            found.value[..., place, :size] = result.innovation
            found.cov[..., place, :size, :size] = result.innovation_cov
            found.nis[..., place] = np.where(taken, result.normalised_innovation_squared, np.nan)
            belief = where(finite_lanes(result.belief), result.belief, belief)
        return belief, found, memory

    def _nothing(self, readings: np.ndarray) -> Innovations:
        shape, m = readings.shape[:-1], self.size
        return Innovations(
            np.full((*shape, m), np.nan), np.full((*shape, m, m), np.nan), np.full(shape, np.nan)
        )


def _put(found: Innovations, nodes: slice | np.ndarray | int, taken: Innovations) -> None:
    """Write innovations of some nodes (R, K, ...), or of one (R, ...), into those of all."""
    for all_values, values in zip(found, taken, strict=True):
        all_values[:, nodes] = values


def innovation_filters(setup: Setup, delivered: tuple[int, int]) -> InnovationFilters | None:
    """The filters of a setup whose nodes are delivered readings (r, d); None where estimates are
    sets, and where sensors have no filter."""
    scenario = with_scripted_moves(setup).scenario
    definition = definition_of(scenario)
    if (
        definition.is_received
        or definition.wirings
        or rule_of(scenario).baseline_filter is not None
    ):
        return None
    own_filter = filter_of(setup)
    filters = LocalFilters(
        definition.model(scenario), definition.sensor_groups(scenario), own_filter
    )
    each = ((node, definition.sensor(scenario, node)) for node in range(scenario.nodes))
    sensors = tuple((node, sensor) for node, sensor in each if sensor is not None)
    size = AllSensors(filters.groups, scenario.nodes, delivered).size
    return InnovationFilters(filters, sensors, size)


class InnovationsByStep:
    """Innovations of the nodes in the runs of these numbers, as their steps come to be known."""

    def __init__(self, setup: Setup, runs: Sequence[int]) -> None:
        nodes, prior = setup.scenario.nodes, priors_of_runs(setup, runs)
        self._setup = setup
        self._before = Gaussian(*(np.repeat(values[:, None], nodes, axis=1) for values in prior))
        self._filters: InnovationFilters | None = None
        self._learnt: Learnt = ()
        self._step = 0

    def add(
        self, after: Gaussian, readings: np.ndarray, control: np.ndarray | None
    ) -> Innovations | None:
        """The innovations (R, N, r, m) of the next step; None as `innovation_filters`.

        `after` (R, N, n) are the nodes' estimates after its last round; readings (R, N, r, d);
        control (R, p) drove the plant into it, None or NaN where nothing did.
        """
        if self._step == 0:
            self._filters = innovation_filters(self._setup, readings.shape[-2:])
        if self._filters is None:
            return None
        driven = None if control is None or np.isnan(control).all() else control
        found, self._learnt = self._filters.of_nodes(
            self._before, readings, driven, self._step, self._learnt
        )
        self._before, self._step = after, self._step + 1
        return found


def innovations_of_nodes(
    setup: Setup,
    runs: Sequence[int],
    belief: Gaussian,
    readings: np.ndarray,
    control: np.ndarray | None,
) -> Innovations | None:
    """Innovations (R, S, N, r, m) of the runs of these numbers; None as `innovation_filters`.

    `belief` (R, S, N, n) are the nodes' estimates, readings (R, S, N, r, d), control (R, S, p).
    """
    steps, found = InnovationsByStep(setup, runs), []
    for step in range(readings.shape[1]):
        after = Gaussian(belief.mean[:, step], belief.cov[:, step])
        now = steps.add(after, readings[:, step], driven_into(control, step))
        if now is None:
            return None
        found.append(now)
    return _stacked(found)


def innovations_of_all(
    setup: Setup,
    runs: Sequence[int],
    readings: np.ndarray,
    control: np.ndarray | None,
    prior_mean: np.ndarray | None = None,
) -> HearsAll | None:
    """The filter that hears everything in the runs of these numbers: (R, S, n), (R, S, N, r, m).

    `prior_mean` (R, n) is drawn anew when left out.
    """
    filters = innovation_filters(setup, readings.shape[-2:])
    if filters is None:
        return None
    own_filter = filters.filters.filter
    belief, learnt = begun(own_filter, priors_of_runs(setup, runs, prior_mean)), ()
    beliefs, found = [], []
    for step in range(readings.shape[1]):
        now, learnt = filters.of_all(
            belief, readings[:, step], driven_into(control, step), step, learnt
        )
        belief = now.belief
        beliefs.append(moments(own_filter, belief))
        found.append(now.innovations)
    history = Gaussian(
        np.stack([one.mean for one in beliefs], axis=1),
        np.stack([one.cov for one in beliefs], axis=1),
    )
    return HearsAll(history, _stacked(found))


def _stacked(steps: Sequence[Innovations]) -> Innovations:
    """Innovations (R, S, ...) of those of each step (R, ...)."""
    return Innovations(*(np.stack(values, axis=1) for values in zip(*steps, strict=True)))
