"""Frame triggerings of FIBEX and AUTOSAR: which ECU sends which frame in which slot and cycle."""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.message_slot import MessageSlot

WITHOUT_ELEMENT = ("period_us", "offset_us", "deadline_us")
"""Fields of a slot for which a frame triggering has no element."""
_NODE = re.compile(r"node_(\d+)")


class Triggering(NamedTuple):
    """A frame in the slots of one channel; `sender` is the name of an ECU, "" if none is known."""

    frame: str
    frame_id: int
    base_cycle: int
    repetition: int
    channel: str
    payload_bytes: int
    sender: str


def slots_of(triggerings: Sequence[Triggering], ecus: Sequence[str]) -> tuple[MessageSlot, ...]:
    """Return the slots of triggerings, in order of frame IDs and base cycles.

    One frame that is triggered alike on both channels is one slot. ECUs that are called node_0,
    node_1, ... keep these numbers; others are numbered in the order of `ecus`. A frame without a
    sender gets a number of its own after them.
    """
    channels: dict[Triggering, set[str]] = {}
    for one in triggerings:
        channels.setdefault(one._replace(channel=""), set()).add(one.channel)
    numbers = _numbers(ecus)
    following = max(numbers.values(), default=-1) + 1
    slots: list[MessageSlot] = []
    for one in sorted(channels, key=lambda key: (key.frame_id, key.base_cycle, key.frame)):
        node = numbers.get(one.sender)
        if node is None:
            node, following = following, following + 1
        slots.append(
            MessageSlot(
                frame_id=one.frame_id,
                # A payload is counted in words of two bytes.
                payload_bytes=one.payload_bytes + one.payload_bytes % 2,
                node=node,
                channel=cast(Channels, "".join(sorted(channels[one]))),
                base_cycle=one.base_cycle,
                repetition=one.repetition,
            )
        )
    return tuple(slots)


def frame_name(slot: MessageSlot) -> str:
    """Return a name that no other slot of a table has."""
    return f"frame_{slot.frame_id}_{slot.base_cycle}_{slot.repetition}_{slot.channel}"


def ecu_name(node: int) -> str:
    """Return the name of the ECU of a node."""
    return f"node_{node}"


def without_element(slots: Sequence[MessageSlot]) -> tuple[str, ...]:
    """Return the fields that a table states and no frame triggering holds."""

    def stated(field: str) -> bool:
        return any(cast(Any, getattr(slot, field)) is not None for slot in slots)

    return tuple(filter(stated, WITHOUT_ELEMENT))


def _numbers(ecus: Sequence[str]) -> dict[str, int]:
    named = [_NODE.fullmatch(name) for name in ecus]
    if all(named):
        return {match.group(): int(match.group(1)) for match in named if match}
    return {name: number for number, name in enumerate(dict.fromkeys(ecus))}
