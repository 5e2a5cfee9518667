"""Disturbances of the clocks of a network: oscillators that drift, and sync frames that fail."""

from collections.abc import Callable, Iterator
from math import ceil
from typing import NamedTuple

from concord.bus.clocks import ClockDrift, SyncOutage

# The corrections have settled so many cycles after the last change.
SETTLED_CYCLES = 400
# Settled corrections repeat but for a microtick, so the last cycles stand for all later ones.
REPEATED_CYCLES = 32


class Disturbances(NamedTuple):
    """Drifts and outages of the clocks of a network, in cycles of its bus."""

    drifts: tuple[ClockDrift, ...] = ()
    outages: tuple[SyncOutage, ...] = ()

    @property
    def first_cycle(self) -> int:
        """The cycle in which the first of them begins."""
        return min(one.first_cycle for one in (*self.drifts, *self.outages))

    def settled_from(self, slew_ppm: float) -> int:
        """Return the even cycle from which all corrections have settled."""
        return max(end for _, end in self._unsettled(slew_ppm))

    def without_rest(self, cycle: int, slew_ppm: float) -> tuple["Disturbances", int]:
        """Leave out cycles in which the corrections have settled and nothing begins or ends.

        Returns the disturbances and the cycle, numbered without them; even and odd cycles stay so.
        A cycle that is left out has one of the last ones before it for it.
        """
        unsettled = sorted(self._unsettled(slew_ppm))

        def number(at: int) -> int:
            removed, settled = 0, None
            for begin, end in unsettled:
                if at < begin:
                    if settled is None or at < settled:
                        return at - removed
                    return settled - REPEATED_CYCLES + (at - settled) % REPEATED_CYCLES - removed
                if settled is not None and begin > settled:
                    removed += (begin - settled) // 2 * 2
                settled = end if settled is None else max(end, settled)
            return at - removed

        return self.renumbered(number), number(cycle)

    def renumbered(self, number: Callable[[int], int]) -> "Disturbances":
        """Return the disturbances in cycles with other numbers."""
        return Disturbances(
            tuple(one._replace(first_cycle=number(one.first_cycle)) for one in self.drifts),
            tuple(
                SyncOutage(node, number(first), None if end is None else number(end))
                for node, first, end in self.outages
            ),
        )

    def _unsettled(self, slew_ppm: float) -> Iterator[tuple[int, int]]:
        """Yield when corrections begin to change, and an even cycle when they have settled."""
        for drift in self.drifts:
            ramp = ceil(abs(drift.ppm) / slew_ppm)
            yield drift.first_cycle, _even(drift.first_cycle + ramp + SETTLED_CYCLES)
        for outage in self.outages:
            for change in (outage.first_cycle, outage.end_cycle):
                if change is not None:
                    yield change, _even(change + SETTLED_CYCLES)


def _even(cycle: int) -> int:
    return cycle + cycle % 2
