"""Slot tables as files: which node sends how much in which slot, and how often.

A TOML table is a list of `[[slots]]`, each with a line per field of `MessageSlot`. The exchange
formats of clusters have slot tables, too.
"""

import tomllib
from collections.abc import Sequence
from functools import lru_cache
from math import inf
from pathlib import Path

import msgspec

from concord.bus.flexray.cluster import Cluster, ClusterError
from concord.bus.flexray.cluster_files import ClusterFileFormat
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.frame import MAX_FRAME_ID
from concord.bus.flexray.slot_table import REPETITIONS
from concord.entries import chosen, entries


class SlotFileError(ValueError):
    """A slot table that cannot be read, or does not fit its cluster."""


class _Table(msgspec.Struct, forbid_unknown_fields=True):
    slots: list[MessageSlot]


def slots_to_toml(slots: Sequence[MessageSlot]) -> str:
    """The TOML text of a slot table."""
    parts: list[str] = []
    for slot in slots:
        parts.append("[[slots]]")
        for field, value in msgspec.structs.asdict(slot).items():
            if value is not None and (field, value) != ("urgency_class", 0):
                parts.append(f'{field} = "{value}"' if field == "channel" else f"{field} = {value}")
        parts.append("")
    return "\n".join(parts)


def read_slot_file(path: Path, cluster: Cluster) -> tuple[MessageSlot, ...]:
    """Read a slot table for a cluster, in order of frame IDs and base cycles.

    Of the clusters of an exchange file the only one counts, or that with the name of the cluster.

    Raises:
        SlotFileError: the file cannot be read, or an entry breaks a rule of FlexRay.
    """
    try:
        if path.suffix in entries("CLUSTER_FILES"):
            return _from_exchange_file(path.read_bytes(), path.suffix, cluster)
        return slots_from_toml(path.read_text(encoding="utf-8"), cluster)
    except OSError as error:
        raise SlotFileError(
            f"{path}: cannot be read ({error.strerror}); name a slot table"
        ) from None
    except ValueError as error:
        raise SlotFileError(f"{path}: {error}") from None


# Kept: every node of a network reads the same table.
@lru_cache(8)
def _from_exchange_file(data: bytes, ending: str, cluster: Cluster) -> tuple[MessageSlot, ...]:
    form: ClusterFileFormat = chosen("CLUSTER_FILES", ending)
    try:
        slots = form.slots(data, None)
    except ClusterError:
        slots = form.slots(data, cluster.name)
    return checked_slots(slots, cluster)


@lru_cache(8)
def slots_from_toml(text: str, cluster: Cluster) -> tuple[MessageSlot, ...]:
    """Return the slots of a TOML text, in order of frame IDs and base cycles.

    Raises:
        SlotFileError: the text is no slot table, or an entry breaks a rule of FlexRay.
    """
    try:
        table = msgspec.convert(tomllib.loads(text), _Table)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise SlotFileError(f"is no slot table: {error}") from None
    return checked_slots(table.slots, cluster)


def checked_slots(table: Sequence[MessageSlot], cluster: Cluster) -> tuple[MessageSlot, ...]:
    """Return slots in order of frame IDs and base cycles.

    Raises:
        SlotFileError: an entry breaks a rule of FlexRay, or two meet in a cycle.
    """
    for slot in table:
        problem = _problem(slot, cluster)
        if problem:
            raise SlotFileError(f"frame ID {slot.frame_id}: {problem}")
    slots = sorted(table, key=lambda slot: (slot.frame_id, slot.base_cycle))
    for place, slot in enumerate(slots):
        for other in slots[place + 1 :]:
            if other.frame_id != slot.frame_id:
                break
            if _meet(slot, other):
                raise SlotFileError(
                    f"frame ID {slot.frame_id}: nodes {slot.node} and {other.node} send in "
                    "the same cycle; give them base cycles that never meet"
                )
    return tuple(slots)


def _problem(slot: MessageSlot, cluster: Cluster) -> str:
    """Return the rule that an entry breaks; nothing if there is none."""
    static = slot.frame_id <= cluster.static_slots
    limit = cluster.static_payload_bytes if static else cluster.dynamic_payload_bytes
    if not 1 <= slot.frame_id <= MAX_FRAME_ID:
        return f"frame IDs are 1 to {MAX_FRAME_ID}"
    if not static and not cluster.minislots:
        return f"cluster {cluster.name!r} ends at slot {cluster.static_slots}"
    if slot.payload_bytes % 2 or not 0 <= slot.payload_bytes <= limit:
        segment = "static" if static else "dynamic"
        return (
            f"payload_bytes is {slot.payload_bytes}, but a {segment} frame of cluster "
            f"{cluster.name!r} carries an even number from 0 to {limit}"
        )
    if slot.repetition not in REPETITIONS or cluster.number_of_cycles % slot.repetition:
        return f"repetition is {slot.repetition}, but controllers repeat every 1, 2, 4, ..., 64"
    if not 0 <= slot.base_cycle < slot.repetition:
        return f"base_cycle is {slot.base_cycle}, but must be 0 to {slot.repetition - 1}"
    if not set(slot.channel) <= set(cluster.channels):
        return f"channel is {slot.channel}, but cluster {cluster.name!r} has {cluster.channels}"
    return _problem_of_request(slot, cluster)


def _problem_of_request(slot: MessageSlot, cluster: Cluster) -> str:
    """Return what is wrong with the node of an entry, or with the times of its requests."""
    if slot.node < 0:
        return f"node is {slot.node}, but nodes are numbered from 0"
    latest = slot.latest_transmission_minislot
    if latest is not None and not 0 <= latest <= cluster.minislots:
        return (
            f"latest_transmission_minislot (pLatestTx) is {latest}, but must be 0 to "
            f"{cluster.minislots}"
        )
    if slot.urgency_class < 0:
        return f"urgency_class is {slot.urgency_class}, but classes are numbered from 0"
    for field in ("period_us", "deadline_us"):
        value = getattr(slot, field)
        if value is not None and not 0 < value < inf:
            return f"{field} is {value}, but must be a positive number"
    if slot.offset_us is not None and (slot.period_us is None or not 0 <= slot.offset_us < inf):
        return f"offset_us is {slot.offset_us}; it needs a period_us, and must be 0 or more"
    return ""


def _meet(one: MessageSlot, other: MessageSlot) -> bool:
    """Whether both may send in one cycle, on one channel."""
    if not set(one.channel) & set(other.channel):
        return False
    shorter = min(one.repetition, other.repetition)
    return one.base_cycle % shorter == other.base_cycle % shorter
