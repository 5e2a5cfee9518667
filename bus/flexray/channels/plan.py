"""Which channels of a cluster carry which shares of a network."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.schedule import Schedule

STARTUP_NODES = 3
"""Nodes that start a cluster, where nothing else is stated."""


class ChannelPlan(NamedTuple):
    """Channels of the shares in static slots, and of those in dynamic ones.

    Several channels are dealt out in turn: to the places in a cycle, and to the contenders.
    """

    static: tuple[Channels, ...]
    dynamic: tuple[Channels, ...]

    @property
    def is_apart(self) -> bool:
        """Whether the channels carry different frames."""
        return len(self.static) > 1 or len(self.dynamic) > 1


class StaticPlace(NamedTuple):
    """The first slot of the share in a place of the static segment, and its channel."""

    first_id: int
    channel: Channels


CHANNEL_PLANS: dict[str, ChannelPlan] = {
    "A": ChannelPlan(("A",), ("A",)),
    "B": ChannelPlan(("B",), ("B",)),
    "split": ChannelPlan(("A", "B"), ("A", "B")),
    "mixed": ChannelPlan(("AB",), ("A", "B")),
}


def on_all(channels: Channels) -> ChannelPlan:
    """Return the plan in which every frame is on all of these channels."""
    return ChannelPlan((channels,), (channels,))


def channel_plan(name: str, channels: Channels, cluster: str) -> ChannelPlan:
    """Return the plan of a name on a cluster with these channels; "all" is no entry of the table,
    as its channels are those of the cluster.

    Raises:
        ValueError: the cluster lacks a channel of the plan.
    """
    plan = CHANNEL_PLANS.get(name, on_all(channels))
    used = set("".join((*plan.static, *plan.dynamic)))
    if not used <= set(channels):
        raise ValueError(
            f"--channels {name}: the plan uses channels {' and '.join(sorted(used))}, but cluster "
            f"{cluster!r} has channel {channels} alone; use --cluster fitted-ab, a cluster with "
            "both channels, or --channels all"
        )
    return plan


def static_places(
    schedule: Schedule, frames: int, plan: ChannelPlan, key_slots: Collection[int] = ()
) -> tuple[StaticPlace, ...]:
    """Return the slots of each place in the cycle, in order, where a share takes so many frames.

    A sync node sends in its key slot on both channels (FlexRay protocol specification 2.1, chapter
    8). So key slots that the cluster states are on both, else those of the first three nodes that
    own a slot in every cycle.
    """
    free = {"A": 1, "B": 1}
    places: list[StaticPlace] = []
    keys = 0
    for number in range(max(map(len, schedule.static_table))):
        channel = min(plan.static, key=lambda one: max(free[letter] for letter in one))
        if len(plan.static) > 1 and _is_owned(schedule, number):
            first = max(free.values())
            stated = any(first <= slot < first + frames for slot in key_slots)
            if stated or (not key_slots and keys < STARTUP_NODES):
                channel, keys = "AB", keys + 1
        first = max(free[letter] for letter in channel)
        free |= dict.fromkeys(channel, first + frames)
        places.append(StaticPlace(first, channel))
    return tuple(places)


def contender_groups(
    contenders: Sequence[int], plan: ChannelPlan
) -> list[tuple[Channels, Sequence[int]]]:
    """Return the contenders that each slot counter of the dynamic segment counts, by channel."""
    count = len(plan.dynamic)
    return [(channel, contenders[place::count]) for place, channel in enumerate(plan.dynamic)]


def _is_owned(schedule: Schedule, place: int) -> bool:
    """Whether one node owns a place in every cycle."""
    owners = {row[place] if place < len(row) else None for row in schedule.static_table}
    return len(owners) == 1
