"""Start-up of a cluster, cycle by cycle (FlexRay 2.1, 7.2)."""

from collections.abc import Sequence

import numpy as np

from concord.bus.arbitration import Numbers
from concord.bus.flexray.clocks.controller_states import PocState, controllers, sent_frames
from concord.bus.flexray.clocks.correction import Corrections, CycleTiming, arrivals
from concord.bus.flexray.clocks.network import ClusterClocks, Passed, run_cycle
from concord.bus.flexray.clocks.settings import TICK, ClockSettings, Mask

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


_RESOLUTION_CYCLES = 4
_JOIN_CYCLES = 3
_CHECKED_PAIRS = 2


class ColdStart:
    """A cluster between power-on and normal operation.

    Attributes:
        settings: of the cluster. network: clocks and controllers; its cycle counts from the last
            collision avoidance symbol.
        cycles: since the first such symbol. attempts: how often a leading node has begun.
        leader: the leading cold-start node. collided: nodes that sent the symbol at one time.
        active_from: (N,), cycles since the first symbol until a node was normal active, -1 before.
        refused: (N,), the rate would exceed pRateCorrectionOut.
    """

    def __init__(self, settings: ClockSettings, period: Numbers, power_on: Numbers) -> None:
        """Bring the cluster to the first collision avoidance symbol.

        Args:
            period: (N,), length of each node's microtick in units (`correction.periods`).
            power_on: (N,), in units.

        Raises:
            ValueError: fewer than two nodes start the cluster.
        """
        starters = [one.node for one in settings.sync if one.starts]
        if len(starters) < 2:
            raise ValueError(
                f"{len(starters)} node starts the cluster, but a cold start takes two; name the "
                "key slots of two or three nodes in startup_slots"
            )
        nodes = len(period)
        self.settings = settings
        self.cycles, self.attempts = 0, 0
        self.active_from = np.full(nodes, -1)
        self.refused = np.zeros(nodes, dtype=np.bool_)
        self._period = period
        self._starters = starters
        self._followed = np.full(nodes, -1)
        self._first_arrival = np.zeros(nodes, dtype=np.int64)
        self._steps = np.zeros(nodes, dtype=np.int64)
        first = self._lead(power_on)
        self._power_on = power_on - first

    def _lead(self, idle_since: Numbers) -> int:
        """Let the first cold-start nodes send the symbol; return when they do so.

        Frames decide between those that collide: the lowest key slot is the first to send one.
        """
        settings = self.settings
        first, self.collided = first_symbols(settings, self._starters, self._period, idle_since)
        self.leader = self.collided[0]
        self.refused[:] = False
        self._left = settings.attempts
        self._count_attempt()
        begun = controllers(len(self._period), PocState.LISTEN)
        state = begun.state.copy()
        state[list(self.collided)] = PocState.COLLISION_RESOLUTION
        none = np.zeros(len(state), dtype=np.int64)
        timing = CycleTiming(none, none, self._period)
        self.network = ClusterClocks(0, timing, begun._replace(state=state))
        return first

    def _count_attempt(self) -> None:
        self.attempts += 1
        self._left -= 1

    @property
    def is_over(self) -> bool:
        """Whether no node starts or integrates any more, nor can."""
        waiting = self.network.controllers.state < PocState.ACTIVE
        return not (waiting & ~self.refused).any() or self.has_failed

    @property
    def has_failed(self) -> bool:
        """Whether no node leads the start, and no node is active."""
        state = self.network.controllers.state
        return bool((state == PocState.LISTEN).all())

    def step(self, delays: Numbers) -> Passed:
        """Run one cycle with the delays (N, S) of its sync frames, in units."""
        before, settings = self.network, self.settings
        sent = sent_frames(settings, before.controllers.state)
        arrived = arrivals(settings, before.timing, delays)
        network, passed = run_cycle(settings, before, delays)
        self.cycles += 1
        state = network.controllers.state.copy()
        timing = CycleTiming(*(array.copy() for array in network.timing))
        heard = passed.measured.known & settings.starters & ~self._own
        for node in np.flatnonzero(before.controllers.state < PocState.ACTIVE).tolist():
            state[node] = self._after(node, before, sent, arrived, timing, heard[node], passed)
        if (before.controllers.state == PocState.GAP).any():
            self._count_attempt()
            network = network._replace(cycle=0, even=None)
        self.active_from[(state == PocState.ACTIVE) & (self.active_from < 0)] = self.cycles
        self.network = network._replace(
            timing=timing, controllers=network.controllers._replace(state=state)
        )
        if state[self.leader] == PocState.LISTEN:
            self._change_leader()
        return passed

    def _change_leader(self) -> None:
        """Let the other cold-start nodes lead when one has used its attempts."""
        self._starters.remove(self.leader)
        if not self._starters:
            listens = np.full(len(self._period), PocState.LISTEN)
            silent = self.network.controllers._replace(state=listens)
            self.network = self.network._replace(controllers=silent)
            return
        per_cycle = self.settings.microticks * TICK
        now = self.cycles * per_cycle
        first = self._lead(np.maximum(self._power_on, now))
        # Cycles are counted on through the silence.
        self.cycles += -(-(first - now) // per_cycle)

    @property
    def _own(self) -> Mask:
        return np.arange(len(self._period))[:, None] == self.settings.senders

    def _after(
        self,
        node: int,
        before: ClusterClocks,
        sent: Mask,
        arrived: Numbers,
        timing: CycleTiming,
        heard: Mask,
        passed: Passed,
    ) -> PocState:
        """Return the state of a starting node after a cycle; set its clock where it integrates."""
        state, is_odd = PocState(before.controllers.state[node]), before.even is not None
        match state:
            case PocState.LISTEN:
                return self._listen(node, before, sent, arrived)
            case PocState.INITIALIZE_SCHEDULE:
                return self._initialize(node, before, sent, arrived, timing)
            case PocState.COLLISION_RESOLUTION:
                if node != self.leader:
                    return PocState.LISTEN
                over = before.cycle == _RESOLUTION_CYCLES - 1
                return PocState.CONSISTENCY_CHECK if over else state
            case PocState.GAP:
                return PocState.COLLISION_RESOLUTION
        pairs = heard & before.even.known[node] if before.even is not None else heard
        fails = passed.corrections is not None and _fails(passed.corrections, node)
        if state == PocState.CONSISTENCY_CHECK:
            if fails or not pairs.any():
                return PocState.GAP if self._left else PocState.LISTEN
            return PocState.ACTIVE if is_odd else state
        if fails or not _sees_enough(
            state, pairs, bool(pairs[self._followed[node]]), not self._steps[node]
        ):
            return PocState.LISTEN
        return self._follow(node, state, pairs, is_odd)

    def _listen(self, node: int, before: ClusterClocks, sent: Mask, arrived: Numbers) -> PocState:
        """Take the first startup frame of an even cycle as the one to integrate on."""
        begun = self.cycles - 1
        awake = self._power_on[node] <= begun * self.settings.microticks * TICK
        startup = np.flatnonzero(sent & self.settings.starters & ~self._own[node])
        if before.even is not None or not awake or not len(startup):
            return PocState.LISTEN
        self._followed[node] = startup[0]
        self._first_arrival[node] = arrived[node, startup[0]]
        return PocState.INITIALIZE_SCHEDULE

    def _initialize(
        self, node: int, before: ClusterClocks, sent: Mask, arrived: Numbers, timing: CycleTiming
    ) -> PocState:
        """Set clock and rate by two startup frames of one node."""
        settings, followed = self.settings, int(self._followed[node])
        if not sent[followed]:
            return PocState.LISTEN
        both = int(self._first_arrival[node]), int(arrived[node, followed])
        rate, start = schedule_from(settings, followed, both, int(timing.period[node]))
        self.refused[node] = abs(rate) > settings.rate_limit
        if self.refused[node]:
            return PocState.LISTEN
        timing.rate[node], timing.start[node] = rate, start
        self._steps[node] = 0
        # A node without attempts left integrates as those that never had one.
        return PocState.COLDSTART_CHECK if node in self._starters else PocState.INTEGRATION_CHECK

    def _follow(self, node: int, state: PocState, pairs: Mask, is_odd: bool) -> PocState:
        """Return the next state of a node whose cycle was sound."""
        if state == PocState.COLDSTART_CHECK:
            return PocState.JOIN if is_odd else state
        if state == PocState.JOIN:
            self._steps[node] += 1
            return PocState.ACTIVE if self._steps[node] == _JOIN_CYCLES else state
        if is_odd:
            # The first pair of cycles counts only if two nodes have sent startup frames in it.
            self._steps[node] = self._steps[node] + 1 if pairs.sum() >= 2 else 0
        return PocState.ACTIVE if self._steps[node] == _CHECKED_PAIRS else state


def _fails(done: Corrections, node: int) -> bool:
    return bool(done.exceeded[node] or done.missing[node])


def _sees_enough(state: PocState, pairs: Mask, follows: bool, is_first: bool) -> bool:
    """Whether the startup frames that a node hears let it go on.

    Args:
        pairs: (S,), frames that it heard. follows: that of the node it integrated on is among them.
        is_first: no pair of cycles was sound so far.
    """
    if state == PocState.COLDSTART_CHECK:
        return follows
    if state == PocState.JOIN:
        return bool(pairs.any())
    return pairs.sum() >= 2 or (follows and is_first)
