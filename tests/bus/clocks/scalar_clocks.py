"""Clock synchronisation of FlexRay once more, node by node, with fractions of real time.

Written from the description of the protocol, not from the arrays of `bus/flexray/clocks`.
"""

import math
from collections.abc import Sequence
from fractions import Fraction

from concord.bus.flexray.clocks.settings import ClockSettings


def sorted_and_dropped(values: Sequence[int]) -> int:
    """The fault-tolerant midpoint: extremes are dropped one by one."""
    left = sorted(values)
    for _ in range(0 if len(values) < 3 else 1 if len(values) < 8 else 2):
        left.remove(max(left))
        left.remove(min(left))
    return math.trunc(Fraction(left[0] + left[-1], 2)) if left else 0


class ScalarNode:
    """A node with a clock of its own; times are in nominal microticks of absolute time."""

    def __init__(self, settings: ClockSettings, ppm: int) -> None:
        self.settings = settings
        self.tick = 1 - Fraction(ppm, 10**6)
        self.cycle_start = Fraction(0)
        self.rate = 0
        self.heard: list[dict[int, int]] = []

    def microticks_to(self, macrotick: int) -> int:
        length = self.settings.microticks + self.rate
        return math.floor(Fraction(macrotick * length, self.settings.macroticks))

    def instant(self, macrotick: int) -> Fraction:
        return self.cycle_start + self.microticks_to(macrotick) * self.tick

    def hear(self, nodes: Sequence["ScalarNode"]) -> None:
        heard = {}
        for rank, one in enumerate(self.settings.sync):
            point = int(self.settings.action_points[rank])
            arrival = nodes[one.node].instant(point)
            counted = math.floor((arrival - self.cycle_start) / self.tick)
            heard[rank] = 0 if nodes[one.node] is self else counted - self.microticks_to(point)
        self.heard.append(heard)

    def end_cycle(self) -> None:
        length = self.settings.microticks + self.rate
        if len(self.heard) == 2:
            even, odd = self.heard
            length += sorted_and_dropped(list(odd.values()))
            wanted = self.rate + sorted_and_dropped([odd[rank] - even[rank] for rank in odd])
            for _ in range(self.settings.damping):
                wanted -= (wanted > 0) - (wanted < 0)
            self.rate = wanted
            self.heard = []
        self.cycle_start += length * self.tick


def scalar_starts(settings: ClockSettings, ppm: Sequence[int], cycles: int) -> list[list[Fraction]]:
    """Return when each cycle of each node begins, from clocks that agree at first."""
    nodes = [ScalarNode(settings, one) for one in ppm]
    found = []
    for _ in range(cycles):
        found.append([node.cycle_start for node in nodes])
        for node in nodes:
            node.hear(nodes)
        for node in nodes:
            node.end_cycle()
    return found
