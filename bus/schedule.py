"""Schedules: which nodes own the static slots of each cycle, and which contend for the rest.

A schedule speaks of nodes and cycles only, so that a state machine or an array program can follow
it without a cluster; `concord.bus.flexray.slot_table` gives it frame IDs, channels and cycle
multiplexing.
"""

import itertools
from collections.abc import Sequence
from functools import lru_cache
from math import gcd, lcm
from typing import NamedTuple

import msgspec


class Group(NamedTuple):
    """Frames of one cycle that are composed at once: static senders in slot order, and up to
    `dynamic_slots` winners of the dynamic segment."""

    senders: tuple[int, ...]
    dynamic_slots: int


class Schedule(msgspec.Struct, frozen=True):
    """Three tables, one row per cycle, each repeated for ever (row `cycle % len(table)`).

    Cycles are counted from the beginning of a run and do not wrap at 64. With `relay` a node
    latches its frame at its own slot, so that it carries what earlier slots of the cycle brought.
    Raises ValueError for tables that are empty, name a node outside of 0..nodes-1, or name one
    twice in a row.
    """

    nodes: int
    static_table: tuple[tuple[int, ...], ...]
    contender_table: tuple[tuple[int, ...], ...] = ((),)
    dynamic_slot_table: tuple[int, ...] = (0,)
    relay: bool = False

    def __post_init__(self) -> None:
        if self.nodes < 1:
            raise ValueError(f"a schedule for {self.nodes} nodes; it needs at least one")
        if not (self.static_table and self.contender_table and self.dynamic_slot_table):
            raise ValueError("a schedule needs at least one row in each of its tables")
        for row in (*self.static_table, *self.contender_table):
            within = not row or (min(row) >= 0 and max(row) < self.nodes)
            if not within or len(set(row)) < len(row):
                raise ValueError(
                    f"the row {row} of a schedule must name each of the nodes 0..{self.nodes - 1} "
                    "at most once"
                )
        if min(self.dynamic_slot_table) < 0:
            raise ValueError(f"dynamic slots {self.dynamic_slot_table} must not be negative")

    def static_senders(self, cycle: int) -> tuple[int, ...]:
        """Nodes that own a static slot in this cycle, in order of their slots."""
        return self.static_table[cycle % len(self.static_table)]

    def contenders(self, cycle: int) -> tuple[int, ...]:
        """Nodes that may ask for the dynamic segment; empty: no dynamic segment, no bids."""
        if not self.dynamic_slots(cycle):
            return ()
        return self.contender_table[cycle % len(self.contender_table)]

    def dynamic_slots(self, cycle: int) -> int:
        """At most so many contenders win in this cycle."""
        return self.dynamic_slot_table[cycle % len(self.dynamic_slot_table)]

    def groups(self, cycle: int) -> tuple[Group, ...]:
        """Return the groups in order of time: the whole cycle, or each slot with `relay`."""
        static = self.static_senders(cycle)
        dynamic = self.dynamic_slots(cycle) if self.contenders(cycle) else 0
        if not (self.relay and (static or dynamic)):
            return (Group(static, dynamic),)
        return _slot_by_slot(static, dynamic)

    def of_nodes(self, members: Sequence[int], nodes: int) -> "Schedule":
        """The same schedule where its node i is `members[i]` of so many nodes."""
        static, contenders = (
            tuple(tuple(members[node] for node in row) for row in table)
            for table in (self.static_table, self.contender_table)
        )
        return msgspec.structs.replace(
            self, nodes=nodes, static_table=static, contender_table=contenders
        )

    @property
    def period(self) -> int:
        """Cycles after which the whole schedule repeats."""
        return lcm(len(self.static_table), len(self.contender_table), len(self.dynamic_slot_table))


@lru_cache
def _slot_by_slot(static: tuple[int, ...], dynamic: int) -> tuple[Group, ...]:
    # Kept: every node asks in every part of every cycle, and a relaying cycle has many parts.
    return tuple(Group((node,), 0) for node in static) + (Group((), 1),) * dynamic


def full_publish(nodes: int) -> Schedule:
    """Every node owns a static slot in every cycle."""
    return round_robin(nodes, nodes)


def round_robin(nodes: int, slots_per_cycle: int) -> Schedule:
    """Static slots only: in cycle c nodes (c S + 0 .. S-1) mod N send, with S slots per cycle.

    The turn is exact for any N because cycles do not wrap here. It repeats after N / gcd(N, S)
    cycles. A controller does it by cycle multiplexing if that number divides the cluster's number
    of cycles and is a repetition that FlexRay has (1, 2, 4, ..., 64). Otherwise the host must
    reassign slots, which `concord.bus.flexray.slot_table.deviations` reports.
    """
    if not 1 <= slots_per_cycle <= nodes:
        raise ValueError(
            f"{slots_per_cycle} slots per cycle for {nodes} nodes; take a number from 1 to {nodes}"
        )
    return Schedule(nodes, _turns(range(nodes), (slots_per_cycle,)))


def hybrid(nodes: int, occupancy: float, order: Sequence[int] | None = None) -> Schedule:
    """Half of the slots static, half dynamic: S = max(1, round(occupancy N)) publish per cycle.

    The first ceil(N/2) nodes of `order` (0, 1, 2, ... if there is none) share S // 2 static slots
    in turn, one more in even cycles if S is odd; the others contend for what is left of S. Slots
    that the contenders are too few for are static.
    """
    order = range(nodes) if order is None else order
    slots = publishers_per_cycle(nodes, occupancy)
    static_nodes = (nodes + 1) // 2
    contenders = tuple(sorted(order[static_nodes:]))
    even = min(slots // 2, len(contenders))
    odd = min(slots - slots // 2, len(contenders))
    dynamic = (even, odd) if even != odd else (even,)
    turns = _turns(sorted(order[:static_nodes]), [slots - count for count in dynamic])
    return Schedule(nodes, turns, (contenders,), dynamic)


def dynamic_only(nodes: int, occupancy: float) -> Schedule:
    """No static slots: all nodes contend for max(1, round(occupancy N)) dynamic ones."""
    return Schedule(nodes, ((),), (tuple(range(nodes)),), (publishers_per_cycle(nodes, occupancy),))


def publishers_per_cycle(nodes: int, occupancy: float) -> int:
    """S = max(1, round(occupancy N)). Raises ValueError for an occupancy outside of 0..1."""
    if not 0.0 < occupancy <= 1.0:
        raise ValueError(
            f"occupancy is {occupancy}, but must be above 0 and at most 1: the share of the nodes "
            "that publish in a cycle"
        )
    return max(1, round(occupancy * nodes))


def _turns(members: Sequence[int], counts: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """Rows in which `members` take turns, `counts` of them at a time (repeated), for one period."""
    period = len(counts) * len(members) // gcd(len(members), sum(counts))
    turn = itertools.cycle(members)
    return tuple(tuple(itertools.islice(turn, counts[row % len(counts)])) for row in range(period))
