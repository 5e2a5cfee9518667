"""Slots by an integer program: the fewest, or the smallest error from the ages of shares.

Cycles that a frame takes, base + k repetition with repetitions of powers of two, are nested or
disjoint. So frames in one zone need as many slots as meet in the busiest cycle, and first-fit by
growing repetition finds them. The program therefore counts frames by zone, base and repetition
(scipy's milp, HiGHS) and never numbers slots. Frames on both channels get slots of their own.
FlexRay 2.1 gives a static slot of a channel to one node; 3.0 lets nodes take turns in it.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from concord.bus.flexray.cluster import Cluster
from concord.features.flexray_tools.slot_design.demand import DemandError, Item, share_overhead_us
from concord.features.flexray_tools.slot_design.zones import SlotTurn, Zone, places_of, zones_of

Goal = Literal["slots", "error"]
"""The goal of a design: the number of slots, or the error that ages of shares add."""
Edition = Literal["2.1", "3.0.1"]
"""The edition of FlexRay that says whether nodes may share a static slot; 3.0.1: they may."""
_LANES = ("A", "B", "AB")
_TIME_LIMIT_S = 120.0
_INFEASIBLE = 2


_Row = tuple[dict[int, float], float, float]
"""Factors of variables, and the least and the largest sum."""


class Chosen(NamedTuple):
    """One frame of a demand, in its way and on its channels."""

    item: int
    place: SlotTurn
    channel: str


class _Column(NamedTuple):
    """How many frames of an item go this way; slots belong to one owner."""

    item: int
    place: SlotTurn
    lane: str
    owner: int


class SolvedSlots(NamedTuple):
    """The zones, the way of every frame of every item, and whether no better one exists."""

    zones: list[Zone]
    chosen: list[Chosen]
    exact: bool


def solve(items: Sequence[Item], cluster: Cluster, goal: Goal, edition: Edition) -> SolvedSlots:
    """Return the slots of every item.

    Raises:
        DemandError: the cluster has too few slots, or none were found in time.
    """
    zones = zones_of(items, cluster)
    columns = list(_columns(items, zones, cluster, goal, edition))
    found = _solved(items, cluster, zones, columns, goal, limited=True)
    if found.x is None:
        raise DemandError(_no_room(items, cluster, zones, columns, found.status))
    counts = np.rint(found.x[: len(columns)]).astype(int)
    chosen = [
        Chosen(column.item, column.place, column.lane)
        for column, count in zip(columns, counts, strict=True)
        for _ in range(count)
    ]
    return SolvedSlots(zones, chosen, found.status == 0)


def _no_room(
    items: Sequence[Item],
    cluster: Cluster,
    zones: Sequence[Zone],
    columns: Sequence[_Column],
    status: int,
) -> str:
    if status != _INFEASIBLE:
        return (
            f"no table was found in {_TIME_LIMIT_S:g} s; use fewer frames with offset_us, or the "
            "goal slots"
        )
    needed = _solved(items, cluster, zones, columns, "slots", limited=False).x
    slots = needed[len(columns) : len(columns) + len(zones)].sum()
    room = ", ".join(
        f"{round(count)} of slots {zone.first} to {zone.last}"
        for zone, count in zip(zones, needed[len(columns) :], strict=False)
        if count > zone.last - zone.first + 1
    )
    return (
        f"the frames need {round(slots)} static slots ({room}), but cluster {cluster.name!r} has "
        f"{cluster.static_slots}; allow longer deadlines and ages, move offsets, or use a cluster "
        "with more slots or two channels"
    )


def _columns(
    items: Sequence[Item],
    zones: Sequence[Zone],
    cluster: Cluster,
    goal: Goal,
    edition: Edition,
) -> Iterator[_Column]:
    for number, item in enumerate(items):
        for place in places_of(item, zones, cluster):
            # Less often never takes more room, so only the error asks for more often.
            if goal == "slots" and place.repetition != max(item.repetitions):
                continue
            for lane in item.channels:
                yield _Column(number, place, lane, owner_of(item, edition))


def _solved(
    items: Sequence[Item],
    cluster: Cluster,
    zones: Sequence[Zone],
    columns: Sequence[_Column],
    goal: Goal,
    limited: bool,
) -> Any:
    """Return scipy's result: frames of each column, then slots of each zone.

    The variables are a count for each column, then slots of each zone, then those of them for both
    channels. A choice of each (item, base, repetition, lane) follows, which holds an item of
    several frames together. The last are the slots of each owner in each zone and lane.
    """
    turns = list(dict.fromkeys((c.item, c.place[1:], c.lane) for c in columns))
    first_zone, first_both = len(columns), len(columns) + len(zones)
    first_turn = first_both + len(zones)
    groups = list(dict.fromkeys((c.place.zone, c.lane, c.owner) for c in columns))
    first_group = first_turn + len(turns)
    size = first_group + len(groups)
    rows: list[_Row] = []
    for number in range(len(items)):
        chosen = [first_turn + k for k, turn in enumerate(turns) if turn[0] == number]
        rows.append((dict.fromkeys(chosen, 1.0), 1.0, 1.0))
    of_turn: dict[Any, list[int]] = {turn: [] for turn in turns}
    for k, column in enumerate(columns):
        of_turn[column.item, column.place[1:], column.lane].append(k)
    for k, turn in enumerate(turns):
        together = dict.fromkeys(of_turn[turn], 1.0)
        rows.append(({**together, first_turn + k: -float(items[turn[0]].copies)}, 0.0, 0.0))
    for k, (zone, lane, owner) in enumerate(groups):
        rows += _meetings(columns, (zone, lane, owner), first_group + k)
    for zone in range(len(zones)):
        both = {first_both + zone: -1.0}
        rest = {first_zone + zone: -1.0, first_both + zone: 1.0}
        for lane in _LANES:
            owned = [first_group + k for k, one in enumerate(groups) if one[:2] == (zone, lane)]
            room = both if lane == "AB" else rest
            rows.append(({**dict.fromkeys(owned, 1.0), **room}, -np.inf, 0.0))
    cost = np.zeros(size)
    if goal == "slots":
        cost[first_zone:first_both] = 1.0
    else:
        for k, (number, (_, repetition), _) in enumerate(turns):
            cost[first_turn + k] = items[number].growth * repetition * cluster.cycle_us
        # Of equal errors the one with fewer slots, which together weigh less than any error.
        step = min((one for one in cost if one > 0), default=1.0)
        cost[first_zone:first_both] = 1e-3 * step / (1 + cluster.static_slots)
    upper: Any = np.full(size, np.inf)
    upper[first_turn:first_group] = 1.0
    if limited:
        upper[first_zone:first_both] = [zone.last - zone.first + 1 for zone in zones]
    return _milp(cost, upper, rows)


def _milp(cost: np.ndarray, upper: Any, rows: Sequence[_Row]) -> Any:
    """Return scipy's result for whole numbers from 0 to `upper` that keep all rows."""
    # scipy takes longer to load than commands that design nothing take to run.
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csr_array

    place = [number for number, (entries, _, _) in enumerate(rows) for _ in entries]
    column_of = [column for entries, _, _ in rows for column in entries]
    value = [factor for entries, _, _ in rows for factor in entries.values()]
    matrix: Any = csr_array((value, (place, column_of)), shape=(len(rows), len(cost)))
    lowest: Any = np.array([row[1] for row in rows])
    highest: Any = np.array([row[2] for row in rows])
    return milp(
        cost,
        integrality=np.ones(len(cost)),
        bounds=Bounds(0, upper),
        constraints=[LinearConstraint(matrix, lowest, highest)],
        options={"time_limit": _TIME_LIMIT_S, "mip_rel_gap": 0.0},
    )


def _meetings(
    columns: Sequence[_Column], group: tuple[int, str, int], slots: int
) -> Iterator[_Row]:
    """Yield for each cycle that the slots of a group hold all its frames that meet in it."""
    own = [
        (k, column.place)
        for k, column in enumerate(columns)
        if (column.place.zone, column.lane, column.owner) == group
    ]
    for cycle in range(max(place.repetition for _, place in own)):
        here = {k: 1.0 for k, place in own if cycle % place.repetition == place.base_cycle}
        if here:
            yield {**here, slots: -1.0}, -np.inf, 0.0


def owner_of(item: Item, edition: Edition) -> int:
    """Return which items may share a slot: those of one node, or all."""
    return item.node if edition == "2.1" else 0


def error_of(item: Item, repetition: int, cluster: Cluster) -> float:
    """Return the error that the largest age of a share adds: growth times that age."""
    overhead_us = share_overhead_us(cluster, item.copies)
    return item.growth * (repetition * cluster.cycle_us + overhead_us)
