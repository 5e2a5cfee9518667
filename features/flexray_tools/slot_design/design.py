"""A slot table for frames and shares on a cluster, with every deadline met."""

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple, cast

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.slot_file import checked_slots
from concord.features.flexray_tools.slot_design.demand import Demand, Item, items_of
from concord.features.flexray_tools.slot_design.programme import (
    Chosen,
    Edition,
    Goal,
    error_of,
    owner_of,
    solve,
)
from concord.features.flexray_tools.slot_design.zones import SlotTurn, Zone


class SlotDesign(NamedTuple):
    """A slot table, the number of static slots in use, and the error that ages of shares add.

    `exact` says that no table has fewer slots, or less error; otherwise the time was over.
    """

    slots: tuple[MessageSlot, ...]
    used_slots: int
    error: float
    exact: bool


def design_slots(
    demand: Demand, cluster: Cluster, goal: Goal = "slots", edition: Edition = "3.0.1"
) -> SlotDesign:
    """Return a slot table in which every frame and share is in time.

    With the goal "slots" no table has fewer static slots; where frames go on both channels, none
    that gives these slots of their own. With "error" the sum of growth times largest age of all
    shares is least. The edition 2.1 gives each static slot of a channel to one node.

    Raises:
        DemandError: a demand is wrong, or the cluster has no room.
    """
    items = items_of(demand, cluster)
    zones, chosen, exact = solve(items, cluster, goal, edition)
    slots = checked_slots(_numbered(items, zones, chosen, edition), cluster)
    repetitions = {one.item: one.place.repetition for one in chosen}
    error = sum(error_of(items[item], each, cluster) for item, each in repetitions.items())
    return SlotDesign(slots, len({slot.frame_id for slot in slots}), error, exact)


def _numbered(
    items: Sequence[Item], zones: Sequence[Zone], chosen: Sequence[Chosen], edition: Edition
) -> list[MessageSlot]:
    """Give each frame the first slot of its zone that is free in its cycles."""
    owners = [owner_of(item, edition) for item in items]
    slots: list[MessageSlot] = []
    sent: dict[int, int] = defaultdict(int)
    both = _slots_on_both(zones, chosen, owners)
    # Frames that are sent more often go first: of two that meet, the other's cycles are among its.
    for one in sorted(chosen, key=lambda c: (c.channel != "AB", c.place.repetition, c.item)):
        item, zone = items[one.item], zones[one.place.zone]
        first = zone.first + (0 if one.channel == "AB" else both[one.place.zone])
        frame_id = next(
            number
            for number in range(first, zone.last + 1)
            if not any(
                _meet(one, other, edition == "2.1" and other.node != item.node)
                for other in slots
                if other.frame_id == number
            )
        )
        slots.append(
            MessageSlot(
                frame_id=frame_id,
                payload_bytes=-(-item.payloads[sent[one.item]] // 2) * 2,
                node=item.node,
                channel=cast(Channels, one.channel),
                base_cycle=one.place.base_cycle,
                repetition=one.place.repetition,
                period_us=item.period_us,
                offset_us=item.offset_us,
                deadline_us=item.deadline_us,
            )
        )
        sent[one.item] += 1
    return slots


def _slots_on_both(
    zones: Sequence[Zone], chosen: Sequence[Chosen], owners: Sequence[int]
) -> list[int]:
    """Return how many slots of each zone hold the frames that go on both channels."""
    groups: dict[tuple[int, int], list[SlotTurn]] = defaultdict(list)
    for one in chosen:
        if one.channel == "AB":
            groups[one.place.zone, owners[one.item]].append(one.place)
    found = [0] * len(zones)
    for (zone, _), places in groups.items():
        found[zone] += max(
            sum(cycle % place.repetition == place.base_cycle for place in places)
            for cycle in range(max(place.repetition for place in places))
        )
    return found


def _meet(one: Chosen, slot: MessageSlot, of_another: bool) -> bool:
    """Whether a frame cannot share the slot of another, which may belong to another owner."""
    shorter = min(one.place.repetition, slot.repetition)
    same_cycle = one.place.base_cycle % shorter == slot.base_cycle % shorter
    return (same_cycle or of_another) and bool(set(one.channel) & set(slot.channel))
