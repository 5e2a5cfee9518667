"""A cluster from cold start through many cycles, with clocks that deviate and liars among them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import Numbers
from concord.bus.flexray.clocks.controller_states import PocState
from concord.bus.flexray.clocks.correction import instant, periods
from concord.bus.flexray.clocks.network import ClusterClocks, Passed, run_cycle
from concord.bus.flexray.clocks.settings import TICK, ClockSettings, Mask
from concord.features.flexray_tools.clocks.startup import ColdStart

Reals = NDArray[np.float64]


class Conditions(NamedTuple):
    """Conditions under which the clocks of N nodes run.

    Attributes:
        ppm: (N,), how fast each clock is. power_on: (N,), in cycles from the first power-on.
        places: (N,), of the nodes along the cable, from 0 to 1.
        liars: sync nodes whose frames come to each receiver at another time, within its window.
    """

    ppm: Reals
    power_on: Reals
    places: Reals
    liars: tuple[int, ...] = ()


class ClockRun(NamedTuple):
    """Result of a run.

    Attributes:
        start: the cold start. network: clocks and controllers at the end.
        spreads_us: (cycles,), largest difference of two active nodes' clocks in each cycle, liars
            left out. largest_rate, largest_offset: corrections in microticks, of active nodes.
    """

    start: ColdStart
    network: ClusterClocks
    spreads_us: Reals
    largest_rate: int
    largest_offset: int

    @property
    def precision_us(self) -> float:
        """Largest difference of two active nodes' clocks in the run."""
        return float(self.spreads_us.max(initial=0.0))


def draw_conditions(
    nodes: int, ppm: Reals | float, power_on_cycles: float, seed: int, liars: int = 0
) -> Conditions:
    """Draw conditions: places, times of power-on, and clocks where `ppm` is a limit on either side.

    The last sync nodes lie, so that a liar does not start the cluster where others can.
    """
    generator = np.random.default_rng(np.random.SeedSequence(seed))
    places = generator.random(nodes)
    power_on = generator.random(nodes) * power_on_cycles
    drawn = generator.uniform(-1, 1, nodes)
    rates = ppm if isinstance(ppm, np.ndarray) else ppm * drawn + 0.0
    return Conditions(rates, power_on, places, tuple(range(-liars, 0)))


def run_clocks(settings: ClockSettings, conditions: Conditions, cycles: int, seed: int) -> ClockRun:
    """Run so many cycles from the first collision avoidance symbol.

    The start ends early if it fails. `seed` draws the frames of liars alone.
    """
    per_cycle = settings.microticks * TICK
    start = ColdStart(
        settings,
        periods(conditions.ppm),
        np.rint(conditions.power_on * per_cycle).astype(np.int64),
    )
    delays = _Delays(settings, conditions, seed)
    honest = np.ones(len(conditions.ppm), dtype=np.bool_)
    honest[[settings.sync[rank].node for rank in conditions.liars]] = False
    spreads, rate, offset = np.zeros(cycles), 0, 0
    network = start.network
    for cycle in range(cycles):
        spreads[cycle] = spread_us(settings, network, honest)
        if start.is_over:
            network, passed = run_cycle(settings, network, delays.of_cycle())
        else:
            passed = start.step(delays.of_cycle())
            network = start.network
        if start.has_failed:
            break
        rate, offset = _largest(passed, network, honest, (rate, offset))
    return ClockRun(start, network, spreads, rate, offset)


def _largest(
    passed: Passed, network: ClusterClocks, honest: Mask, before: tuple[int, int]
) -> tuple[int, int]:
    active = honest & (network.controllers.state == PocState.ACTIVE)
    if passed.corrections is None or not active.any():
        return before
    done = passed.corrections
    return (
        max(before[0], int(np.abs(done.rate[active]).max())),
        max(before[1], int(np.abs(done.offset[active]).max())),
    )


class _Delays:
    """From the sender of each sync frame to each node: the cable, and the lies of a cycle."""

    def __init__(self, settings: ClockSettings, conditions: Conditions, seed: int) -> None:
        whole = settings.delay_us / settings.microtick_us * TICK
        places = conditions.places
        apart = np.abs(places[:, None] - places[settings.senders])
        self._cable: Numbers = np.rint(apart * whole).astype(np.int64)
        self._liars = list(conditions.liars)
        self._reach = settings.window * TICK
        self._draws = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))

    def of_cycle(self) -> Numbers:
        if not self._liars:
            return self._cable
        lies = self._draws.integers(
            -self._reach, self._reach, (len(self._cable), len(self._liars)), endpoint=True
        )
        delays = self._cable.copy()
        delays[:, self._liars] += lies
        return delays


def spread_us(settings: ClockSettings, network: ClusterClocks, counted: Mask) -> float:
    """Return the largest difference of two active nodes' clocks in a cycle, in microseconds, over
    the nodes that are `counted` (N,).

    Clocks run evenly from the start of the cycle to the offset correction, so the largest
    difference is at either of them.
    """
    active = counted & (network.controllers.state == PocState.ACTIVE)
    if active.sum() < 2:
        return 0.0
    timing = network.timing
    late = instant(settings, timing, settings.correction_start)
    most = max(int(np.ptp(timing.start[active])), int(np.ptp(late[active])))
    return most / TICK * settings.microtick_us
