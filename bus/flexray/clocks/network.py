"""Clocks and controllers of all nodes of a cluster, from one communication cycle to the next."""

from typing import NamedTuple

import numpy as np

from concord.bus.arbitration import Numbers
from concord.bus.flexray.clocks.controller_states import (
    CORRECTED,
    Controllers,
    PocState,
    after_pair,
    controllers,
    sent_frames,
)
from concord.bus.flexray.clocks.correction import (
    Corrections,
    CycleTiming,
    Deviations,
    corrections,
    measure,
    next_cycle,
)
from concord.bus.flexray.clocks.settings import ClockSettings, Mask


class ClusterClocks(NamedTuple):
    """All nodes at the beginning of a cycle; `even`: measurements of the even cycle before."""

    cycle: int
    timing: CycleTiming
    controllers: Controllers
    even: Deviations | None = None


class Passed(NamedTuple):
    """Result of one cycle; `corrections` are those of an odd cycle, None after an even one."""

    measured: Deviations
    corrections: Corrections | None


def synchronised(settings: ClockSettings, period: Numbers, cycle: int = 0) -> ClusterClocks:
    """Return a cluster whose nodes are all active and agree on the time; `cycle` is even."""
    none = np.zeros(len(period), dtype=np.int64)
    return ClusterClocks(
        cycle, CycleTiming(none, none, period), controllers(len(period), PocState.ACTIVE)
    )


def run_cycle(
    settings: ClockSettings,
    network: ClusterClocks,
    delays: Numbers,
    received: Mask | bool = True,
) -> tuple[ClusterClocks, Passed]:
    """Return the network after one cycle, with the offset corrected in the idle time of an odd one.

    Args:
        delays: (N, S), from the sender of each sync frame to each node, in units of `TICK`.
        received: (N, S), false where a fault keeps the frame from the node.
    """
    timing, state = network.timing, network.controllers.state
    measured = measure(settings, timing, delays, sent_frames(settings, state) & received)
    none = np.zeros_like(timing.rate)
    if network.even is None:
        after = next_cycle(settings, timing, timing.rate, none)
        return network._replace(cycle=network.cycle + 1, timing=after, even=measured), Passed(
            measured, None
        )
    done = corrections(settings, timing.rate, network.even, measured)
    corrected = np.isin(state, CORRECTED)
    rate = np.where(corrected, done.rate, timing.rate)
    after = next_cycle(settings, timing, rate, np.where(corrected, done.offset, none))
    following = ClusterClocks(
        network.cycle + 1, after, after_pair(settings, network.controllers, done), None
    )
    return following, Passed(measured, done)
