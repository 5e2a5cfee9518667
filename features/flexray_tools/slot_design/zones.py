"""Zones of static slots that are alike to every demand, and where each demand may be placed.

A frame with known request times cares which slot it gets: one before its request is a cycle later,
and one late in the cycle may miss its deadline. Between these limits slots are alike.
"""

from collections.abc import Sequence
from typing import NamedTuple

from concord.bus.flexray.cluster import Cluster
from concord.features.flexray_tools.slot_design.demand import DemandError, Item

_ROUNDING_US = 1e-6


class Zone(NamedTuple):
    """Static slots from the first to the last."""

    first: int
    last: int


class SlotTurn(NamedTuple):
    """A way to send a demand: in which zone, and in which cycles."""

    zone: int
    base_cycle: int
    repetition: int


def zones_of(items: Sequence[Item], cluster: Cluster) -> list[Zone]:
    """Return the zones, in order of slots."""
    starts = {1}
    for item in items:
        if item.offset_us is not None:
            # Slots from here on begin after the request; slots up to here end by the deadline.
            phase_us = item.offset_us % cluster.cycle_us
            last_us = (item.offset_us + _latest_start_us(item, cluster)) % cluster.cycle_us
            starts.add(_first_slot_from(phase_us, cluster))
            starts.add(_first_slot_from(last_us + 2 * _ROUNDING_US, cluster))
    bounds = sorted(one for one in starts if one <= cluster.static_slots)
    return [
        Zone(first, (*bounds, cluster.static_slots + 1)[place + 1] - 1)
        for place, first in enumerate(bounds)
    ]


def places_of(item: Item, zones: Sequence[Zone], cluster: Cluster) -> list[SlotTurn]:
    """Return all ways to send a demand in time.

    Raises:
        DemandError: there is none.
    """
    if item.offset_us is None:
        return [
            SlotTurn(zone, base, repetition)
            for repetition in item.repetitions
            for zone in range(len(zones))
            for base in range(repetition)
        ]
    (repetition,) = item.repetitions
    found: list[SlotTurn] = []
    for number, zone in enumerate(zones):
        slot_us = cluster.slot_start_us(zone.first)
        for base in range(repetition):
            # The first slot of these cycles that begins with the request or after it.
            wait = (item.offset_us - _ROUNDING_US - slot_us) / cluster.cycle_us - base
            turns = max(0, -int(-wait // repetition))
            start_us = (base + turns * repetition) * cluster.cycle_us + slot_us
            if start_us - item.offset_us <= _latest_start_us(item, cluster) + _ROUNDING_US:
                found.append(SlotTurn(number, base, repetition))
    if not found:
        soonest_us = _soonest_us(item, cluster)
        raise DemandError(
            f"{item.name}: no static slot ends within {item.deadline_us:g} us of offset_us "
            f"{item.offset_us:g}; the first one ends after {soonest_us:.1f} us, so allow that, or "
            "move the offset"
        )
    return found


def _latest_start_us(item: Item, cluster: Cluster) -> float:
    """Return how long after a request its slot may begin."""
    frame_us = cluster.frame_us(cluster.static_payload_bytes)
    return item.deadline_us - cluster.action_point_us - frame_us


def _soonest_us(item: Item, cluster: Cluster) -> float:
    assert item.offset_us is not None
    phase_us = item.offset_us % cluster.cycle_us
    slot = _first_slot_from(phase_us, cluster)
    there = slot <= cluster.static_slots
    start_us = cluster.slot_start_us(slot) if there else cluster.cycle_us
    frame_us = cluster.frame_us(cluster.static_payload_bytes)
    return start_us - phase_us + cluster.action_point_us + frame_us


def _first_slot_from(time_us: float, cluster: Cluster) -> int:
    """Return the first slot that begins at a time of the cycle or after it."""
    return 1 - int(-(time_us - _ROUNDING_US) // cluster.static_slot_us)
