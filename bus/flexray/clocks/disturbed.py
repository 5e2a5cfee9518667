"""Clocks of a network in which oscillators drift, or nodes lose their sync frames.

The fault word `drift` disturbs clocks in one way, and faults that silence a sync node in another.
"""

from functools import lru_cache

import numpy as np

from concord.bus.arbitration import Numbers
from concord.bus.clocks import ClockErrors
from concord.bus.flexray.clocks.controller_states import PocState
from concord.bus.flexray.clocks.correction import instant, periods
from concord.bus.flexray.clocks.disturbances import REPEATED_CYCLES, Disturbances
from concord.bus.flexray.clocks.network import ClusterClocks, run_cycle, synchronised
from concord.bus.flexray.clocks.settings import (
    TICK,
    ClockSettings,
    Mask,
    clock_settings,
)
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.publication import SyncNode

_SLEW = 12
"""A drifting clock gains or loses at most this part of the precision in a cycle more than in the
cycle before. Clock correction follows that; a real crystal changes much more slowly."""


def clock_errors(
    cluster: Cluster,
    nodes: int,
    disturbed: Disturbances,
    cycle: int,
    sync: tuple[SyncNode, ...] = (),
) -> ClockErrors:
    """Return how far the clock of each node is off at the end of a cycle, and what it still does.

    The clocks agree until the first disturbance. The rate of an oscillator that drifts then moves
    to its PPM as fast as clock correction follows (`slew_ppm`). Without `sync` nodes the first
    nodes are these.
    """
    moved, number = disturbed.without_rest(cycle, slew_ppm(_settings(cluster, nodes, sync)))
    return _disturbed(cluster, nodes, moved, sync).at(number)


def slew_ppm(settings: ClockSettings) -> float:
    """Return by how much the rate of a drifting clock changes from cycle to cycle."""
    margin = min(settings.precision_us, settings.window * settings.microtick_us)
    return 1e6 * margin / (_SLEW * settings.microticks * settings.microtick_us)


class _DisturbedNodes:
    """The cycles of a cluster since its first disturbance, computed up to the latest one asked
    for."""

    def __init__(self, settings: ClockSettings, nodes: int, disturbed: Disturbances) -> None:
        self._settings = settings
        self._nodes = nodes
        self._disturbed = disturbed
        self._origin = disturbed.first_cycle - disturbed.first_cycle % 2
        self._slew = slew_ppm(settings)
        self._last = disturbed.settled_from(self._slew) - self._origin
        self._delays = np.zeros((nodes, len(settings.sync)), dtype=np.int64)
        self._network = synchronised(settings, self._periods(self._origin), self._origin)
        self._errors: list[ClockErrors] = []

    def at(self, cycle: int) -> ClockErrors:
        number = cycle - self._origin
        if number < 0:
            sure = (True,) * self._nodes
            return ClockErrors((0.0,) * self._nodes, sure, sure)
        if number >= self._last:
            number = self._last - REPEATED_CYCLES + (number - self._last) % REPEATED_CYCLES
        while len(self._errors) <= number:
            self._advance()
        return self._errors[number]

    def _advance(self) -> None:
        cycle = self._network.cycle
        timing = self._network.timing._replace(period=self._periods(cycle))
        network = self._network._replace(timing=timing)
        self._errors.append(self._error(network))
        received = self._received(cycle)
        self._network, _ = run_cycle(self._settings, network, self._delays, received)

    def _periods(self, cycle: int) -> Numbers:
        ppm = np.zeros(self._nodes)
        for drift in self._disturbed.drifts:
            reached = max(0, cycle + 1 - drift.first_cycle) * self._slew
            ppm[drift.node] = np.clip(drift.ppm, -reached, reached)
        return periods(ppm)

    def _received(self, cycle: int) -> Mask:
        """Return which sync frames reach which nodes (N, S); each node knows its own."""
        silent = [
            node
            for node, first, end in self._disturbed.outages
            if first <= cycle and (end is None or cycle < end)
        ]
        senders = self._settings.senders
        own = np.arange(self._nodes)[:, None] == senders
        return own | ~np.isin(senders, silent)

    def _error(self, network: ClusterClocks) -> ClockErrors:
        settings, state = self._settings, network.controllers.state
        reached = instant(settings, network.timing, settings.correction_start)
        nominal = settings.correction_start * settings.microticks // settings.macroticks * TICK
        ahead_us = (nominal - reached) / TICK * settings.microtick_us
        return ClockErrors(
            tuple(ahead_us.tolist()),
            tuple((state == PocState.ACTIVE).tolist()),
            tuple((state != PocState.HALT).tolist()),
        )


@lru_cache(maxsize=16)
def _settings(cluster: Cluster, nodes: int, sync: tuple[SyncNode, ...]) -> ClockSettings:
    return clock_settings(cluster, _everybody(cluster, nodes, sync), sync)


def _everybody(cluster: Cluster, nodes: int, sync: tuple[SyncNode, ...]) -> int:
    """Return the number of nodes, with the other controllers that send sync frames."""
    if sync:
        return max(nodes, *(one.node + 1 for one in sync))
    return max(2, nodes, len(cluster.sync_slots))


@lru_cache(maxsize=16)
def _disturbed(
    cluster: Cluster, nodes: int, disturbed: Disturbances, sync: tuple[SyncNode, ...]
) -> _DisturbedNodes:
    everybody = _everybody(cluster, nodes, sync)
    return _DisturbedNodes(_settings(cluster, nodes, sync), everybody, disturbed)
