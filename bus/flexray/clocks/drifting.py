"""Clocks of a network in which the oscillators of some nodes drift (fault word `drift`)."""

from functools import lru_cache
from math import ceil

import numpy as np

from concord.bus.arbitration import Numbers
from concord.bus.clocks import ClockDrift, ClockErrors
from concord.bus.flexray.clocks.controller_states import PocState
from concord.bus.flexray.clocks.correction import instant, periods
from concord.bus.flexray.clocks.network import ClusterClocks, run_cycle, synchronised
from concord.bus.flexray.clocks.settings import TICK, ClockSettings, clock_settings
from concord.bus.flexray.cluster import Cluster

_SLEW = 12
"""A drifting clock gains or loses at most this part of the precision in a cycle more than in the
cycle before. Clock correction follows that; a real crystal changes much more slowly."""
# The corrections have settled so many cycles after the last change of a rate.
_SETTLED = 400
_KEPT = 32


def clock_errors(
    cluster: Cluster, nodes: int, drifts: tuple[ClockDrift, ...], cycle: int
) -> ClockErrors:
    """Return how far the clock of each node is off at the end of a cycle, and what it still does.

    The clocks agree until the first drift. Each rate then moves to its PPM as fast as clock
    correction follows (`slew_ppm`).
    """
    moved, number = without_rest(drifts, cycle, slew_ppm(_settings(cluster, nodes)))
    return _drifting(cluster, nodes, moved).at(number)


def without_rest(
    drifts: tuple[ClockDrift, ...], cycle: int, slew: float
) -> tuple[tuple[ClockDrift, ...], int]:
    """Leave out cycles in which the corrections have settled and no new drift begins.

    Returns the drifts and the cycle, numbered without them; even and odd cycles stay so. A cycle
    that is left out has one of the last ones before it for it.
    """
    moved: list[ClockDrift] = []
    removed, settled, place = 0, None, cycle
    for drift in sorted(drifts, key=lambda one: (one.first_cycle, one.node)):
        begin = drift.first_cycle
        if settled is not None and begin > settled:
            if settled <= cycle < begin:
                place = settled - _KEPT + (cycle - settled) % _KEPT - removed
            removed += (begin - settled) // 2 * 2
        if cycle >= begin:
            place = cycle - removed
        moved.append(drift._replace(first_cycle=begin - removed))
        end = begin + ceil(abs(drift.ppm) / slew) + _SETTLED
        settled = max(end + end % 2, settled or 0)
    return tuple(moved), place


def slew_ppm(settings: ClockSettings) -> float:
    """Return by how much the rate of a drifting clock changes from cycle to cycle."""
    margin = min(settings.precision_us, settings.window * settings.microtick_us)
    return 1e6 * margin / (_SLEW * settings.microticks * settings.microtick_us)


class _DriftingNodes:
    """The cycles of a cluster since its first drift, computed up to the latest one asked for."""

    def __init__(self, settings: ClockSettings, nodes: int, drifts: tuple[ClockDrift, ...]) -> None:
        self._settings = settings
        self._nodes = nodes
        self._drifts = drifts
        first = min(drift.first_cycle for drift in drifts)
        self._origin = first - first % 2
        self._slew = slew_ppm(settings)
        slowest = max(drift.first_cycle + abs(drift.ppm) / self._slew for drift in drifts)
        self._last = int(slowest) - self._origin + _SETTLED
        self._last += self._last % 2
        self._delays = np.zeros((nodes, len(settings.sync)), dtype=np.int64)
        self._network = synchronised(settings, self._periods(self._origin), self._origin)
        self._errors: list[ClockErrors] = []

    def at(self, cycle: int) -> ClockErrors:
        number = cycle - self._origin
        if number < 0:
            sure = (True,) * self._nodes
            return ClockErrors((0.0,) * self._nodes, sure, sure)
        if number >= self._last:
            # Settled corrections repeat but for a microtick, so the last cycles stand for the rest.
            number = self._last - _KEPT + (number - self._last) % _KEPT
        while len(self._errors) <= number:
            self._advance()
        return self._errors[number]

    def _advance(self) -> None:
        period = self._periods(self._network.cycle)
        timing = self._network.timing._replace(period=period)
        network = self._network._replace(timing=timing)
        self._errors.append(self._error(network))
        self._network, _ = run_cycle(self._settings, network, self._delays)

    def _periods(self, cycle: int) -> Numbers:
        ppm = np.zeros(self._nodes)
        for drift in self._drifts:
            reached = max(0, cycle + 1 - drift.first_cycle) * self._slew
            ppm[drift.node] = np.clip(drift.ppm, -reached, reached)
        return periods(ppm)

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
def _settings(cluster: Cluster, nodes: int) -> ClockSettings:
    return clock_settings(cluster, _everybody(cluster, nodes))


def _everybody(cluster: Cluster, nodes: int) -> int:
    return max(2, nodes, len(cluster.sync_slots))


@lru_cache(maxsize=16)
def _drifting(cluster: Cluster, nodes: int, drifts: tuple[ClockDrift, ...]) -> _DriftingNodes:
    return _DriftingNodes(_settings(cluster, nodes), _everybody(cluster, nodes), drifts)
