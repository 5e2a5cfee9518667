"""Active faults of a network at a moment, and the draws that decide which frames they strike.

Like the fate of a frame (`nodes/faults/losses.py`) a fault is decided by a hash of (cycle, sender,
receiver, frame) under a key of the run and the fault word. So every caller gets the same answer,
and a receiver knows of a slot that stays empty without waiting for it.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

from concord.bus.clocks import ClockDrift, ClockErrors, SyncOutage
from concord.nodes.changes import Fault, Standing
from concord.nodes.faults.losses import fraction
from concord.nodes.faults.vocabulary import PASSING
from concord.nodes.vector_codec import BeliefCodec

# In the place of a receiver: the fault strikes a frame before any node hears it.
EVERYBODY = (1 << 16) + 1


Clocks = Callable[
    [tuple[ClockDrift, ...], tuple[SyncOutage, ...], int, tuple[int, int]], ClockErrors
]
"""(drifts, outages, cycle, key of the draws) -> the clocks of all nodes."""

# A node synchronises its clock by any one sync frame of another node.
_ENOUGH_SYNC_NODES = 2


class Equipment(NamedTuple):
    """Properties of a network that its faults need.

    Attributes:
        channels: of the cluster. cycle_us: length of a cycle, 0 on a bus without time.
        precision_us: how far two clocks may be apart before a frame leaves its slot.
        number: the numpy type code of the numbers in a share; "" for shares of something else.
        codec: of shares that are beliefs.
        noticed_bits: a receiver finds any this many wrong bits in a frame.
        clocks: of the nodes in a cycle, on a bus that keeps them together; None on others.
        sync_nodes: of such a bus (`concord.bus.clocks.KeepsClocks`). rounds: cycles of a step.
        retransmissions: how often the bus sends a frame again after an error.
        neighbours: the nodes that each node hears.
        sync_faults: faults that, at probability 1, leave a node without sync frames.
    """

    channels: str = "A"
    cycle_us: float = 0.0
    precision_us: float = 0.0
    number: str = ""
    codec: BeliefCodec | None = None
    noticed_bits: int = 1
    clocks: Clocks | None = None
    sync_nodes: tuple[int, ...] = ()
    rounds: int = 1
    retransmissions: int = 0
    neighbours: Sequence[Sequence[int]] = ()
    sync_faults: tuple[str, ...] = ()


PLAIN = Equipment()


class Faults(NamedTuple):
    """Active faults, by fault word and place; `key` belongs to (seed, run).

    `outages` are those of sync frames that disturb a clock.
    """

    key: tuple[int, int] = (0, 0)
    equipment: Equipment = PLAIN
    standing: Mapping[tuple[str, tuple[int, ...]], Fault] = {}
    outages: tuple[SyncOutage, ...] = ()

    @property
    def are_active(self) -> bool:
        """Whether any fault can change what a node sends or hears."""
        return bool(self.standing or self.outages)

    def stand(self, standing: Standing) -> "Faults":
        """Return the faults of a network in this state; absent nodes do no harm."""
        active = {
            (fault.kind, fault.nodes): fault
            for fault in standing.faults
            if fault.kind != "babble" or fault.nodes[0] not in standing.absent
        }
        return self._replace(standing=active, outages=self._outages(standing))

    def at(self, kind: str, step: int, *nodes: int) -> tuple[float, ...] | None:
        """The numbers of a fault that befalls these nodes in a step; None for no fault.

        A fault of one link takes precedence over a fault of all links.
        """
        fault = self.standing.get((kind, nodes)) or self.standing.get((kind, ()))
        if fault is None or not fault.numbers[0]:
            return None
        passed = kind in PASSING and step >= fault.first_step + fault.numbers[0]
        return None if passed else fault.numbers

    def first_cycle(self, kind: str, *nodes: int) -> int:
        """The cycle with which a fault that stands has begun."""
        return self.standing[kind, nodes].first_cycle

    def clocks(self, cycle: int) -> ClockErrors | None:
        """Return the clocks of the nodes in a cycle; None where none drifts, or on a bus that does
        not keep clocks together."""
        if self.equipment.clocks is None:
            return None
        drifts = [
            ClockDrift(nodes[0], fault.numbers[0], fault.first_cycle)
            for (kind, nodes), fault in self.standing.items()
            if kind == "drift" and fault.numbers[0]
        ]
        if not drifts and not self.outages:
            return None
        return self.equipment.clocks(tuple(sorted(drifts)), self.outages, cycle, self.key)

    def _outages(self, standing: Standing) -> tuple[SyncOutage, ...]:
        """Return the outages of sync frames, none where they disturb no clock.

        A node that is out, hangs, leaves all its slots empty or sends wrong checksums alone has no
        sync frames. A null frame is one, and so is each frame that a probability below 1 spares.
        """
        sync = self.equipment.sync_nodes
        begins = standing.first_cycle - standing.first_step * self.equipment.rounds
        found = [
            SyncOutage(node, begins + step * self.equipment.rounds)
            for node, step in standing.out_since
        ]
        for fault in standing.faults:
            if fault.kind == "hang" and fault.numbers[0]:
                end_step = fault.first_step + int(fault.numbers[0])
                end = begins + end_step * self.equipment.rounds
                found.append(SyncOutage(fault.nodes[0], fault.first_cycle, end))
            elif fault.kind in self.equipment.sync_faults and fault.numbers[0] == 1:
                found.append(SyncOutage(fault.nodes[0], fault.first_cycle))
        struck = tuple(sorted({one for one in found if one.node in sync}, key=_by_begin))
        sound = {*sync}.difference(one.node for one in struck)
        drifts = any(fault.kind == "drift" and fault.numbers[0] for fault in standing.faults)
        return struck if drifts or len(sound) < _ENOUGH_SYNC_NODES else ()

    def draw(self, kind: str, cycle: int, sender: int, receiver: int, number: int = 0) -> float:
        """In [0, 1); of 16 bits each are sender, receiver and number."""
        return fraction(_salted(self.key, kind), cycle, sender, receiver, number)


HEALTHY = Faults()


def is_silent(faults: Faults, step: int, cycle: int, node: int) -> bool:
    """Whether a node that may send in a cycle leaves its slots empty."""
    if not faults.are_active:
        return False
    if hangs(faults, step, node) or has_lost_clock(faults, cycle, node):
        return True
    missing = faults.at("missing", step, node)
    return missing is not None and faults.draw("missing", cycle, node, EVERYBODY) < missing[0]


def sends_nothing(faults: Faults, step: int, cycle: int, node: int) -> bool:
    """Whether a node is silent in all cycles of the bus, from one of a step on."""
    missing = faults.at("missing", step, node)
    is_stopped = hangs(faults, step, node) or has_lost_clock(faults, cycle, node)
    return is_stopped or (missing is not None and missing[0] == 1)


def hangs(faults: Faults, step: int, node: int) -> bool:
    """Whether a node stands still."""
    return faults.at("hang", step, node) is not None


def has_lost_clock(faults: Faults, cycle: int, node: int) -> bool:
    """Whether a node must not send, as its clock is no longer synchronised."""
    clocks = faults.clocks(cycle)
    return clocks is not None and not clocks.sends[node]


def _by_begin(outage: SyncOutage) -> tuple[int, int]:
    return outage.first_cycle, outage.node


@lru_cache
def _salted(key: tuple[int, int], kind: str) -> tuple[int, int]:
    # A word's number does not depend on which words there are.
    return key[0] ^ zlib.crc32(kind.encode()) << 32, key[1]
