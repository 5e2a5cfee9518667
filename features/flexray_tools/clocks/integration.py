"""First steps of a start-up: the collision avoidance symbol, and a schedule from two frames."""

from collections.abc import Sequence

from concord.bus.arbitration import Numbers
from concord.bus.flexray.clocks.settings import TICK, ClockSettings

# Bits of a collision avoidance symbol after which a node knows that another one sends it
# (cdCASRxLowMin), of four microticks each.
_CAS_MICROTICKS = 29 * 4


def first_symbols(
    settings: ClockSettings, starters: Sequence[int], period: Numbers, idle_since: Numbers
) -> tuple[int, tuple[int, ...]]:
    """Return when the first cold-start node sends the symbol, and all that send it at that time.

    Each listens for pdListenTimeout of its own clock. Nodes that begin before they can detect
    another symbol collide.

    Args:
        starters: the cold-start nodes that have attempts left.
        period: (N,), length of each node's microtick in units.
        idle_since: (N,), in units: the node was switched on, or heard the last frame.
    """
    ready = {node: int(idle_since[node] + settings.listen * period[node]) for node in starters}
    first = min(ready.values())
    deaf = _CAS_MICROTICKS * TICK + round(settings.delay_us / settings.microtick_us * TICK)
    return first, tuple(node for node, instant in ready.items() if instant < first + deaf)


def schedule_from(
    settings: ClockSettings, rank: int, arrivals: tuple[int, int], period: int
) -> tuple[int, int]:
    """Return rate correction and start of the next cycle by two startup frames of one node.

    FlexRay 2.1, 7.2.4.7: the frames of an even and an odd cycle tell the length of the cycle.

    Args:
        rank: of the sync node among all. arrivals: each from the nominal start of its cycle, in
            units. period: of the node that integrates.
    """
    nominal = settings.microticks * TICK
    first, second = arrivals
    rate = (nominal + second - first) // period - settings.microticks
    length = settings.microticks + rate
    elapsed = int(settings.action_points[rank]) * length // settings.macroticks
    return rate, second + (length - elapsed) * period - nominal
