"""Slots of a recorded bus that no frame uses, and a network of concord in them."""

from typing import NamedTuple

import msgspec
import numpy as np

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.share_frames import payload_lengths
from concord.bus.flexray.slot_file import checked_slots
from concord.bus.flexray.slot_table import REPETITIONS
from concord.features.flexray_tools.frame_logs.log_fit import log_slots
from concord.features.flexray_tools.frame_logs.tally import COUNTERS, LogTally
from concord.features.flexray_tools.slot_design.demand import share_overhead_us


class SpareSlots(NamedTuple):
    """A network in the free turns of static slots.

    Attributes:
        free_slots: slots without any frame.
        repetition: smallest one with which the network fits.
        frames_per_share: frames that a share takes.
        age_us: longest time from a reading to the last bit of its share at the neighbours.
        slots: those of the network, from node 0 on, then those of the recorded bus.
    """

    free_slots: tuple[int, ...]
    repetition: int
    frames_per_share: int
    age_us: float
    slots: tuple[MessageSlot, ...]


def free_turns(tally: LogTally, static_slots: int, repetition: int) -> list[tuple[int, int]]:
    """Return static slots and base cycles, with this repetition, in which the log has no frame.

    Null frames count: their slot has an owner. A base cycle that the log does not show is not free.
    """
    used = np.zeros((static_slots + 1, COUNTERS), dtype=bool)
    for row in tally.rows:
        if row.frame_id <= static_slots:
            used[row.frame_id] |= row.seen > 0
    return [
        (frame_id, base)
        for frame_id in range(1, static_slots + 1)
        for base in range(repetition)
        if tally.recorded[base::repetition].any() and not used[frame_id, base::repetition].any()
    ]


def network_in_spare_slots(
    tally: LogTally, cluster: Cluster, nodes: int, share_bytes: int
) -> SpareSlots:
    """Return the slots in which a network fits beside the frames of a bus, as often as possible.

    Args:
        tally: counts of a log of the bus.
        cluster: of the bus.
        nodes: of the network; each sends one share in each of its turns.
        share_bytes: longest share.

    Raises:
        ValueError: the free slots hold no such network, with the number that would fit.
    """
    frames = payload_lengths(share_bytes, cluster.static_payload_bytes)
    unused = tuple(slot for slot, _ in free_turns(tally, cluster.static_slots, 1))
    seen = log_slots(tally, cluster.static_slots, cluster)
    fit_most = 0
    for repetition in REPETITIONS:
        if cluster.number_of_cycles % repetition:
            continue
        free = free_turns(tally, cluster.static_slots, repetition)
        of_base = [[slot for slot, base in free if base == one] for one in range(repetition)]
        groups = [
            (base, slots[first : first + len(frames)])
            for base, slots in enumerate(of_base)
            for first in range(0, len(slots) - len(frames) + 1, len(frames))
        ]
        fit_most = max(fit_most, len(groups))
        if len(groups) < nodes:
            continue
        # Nodes of one base cycle stand together, so that their shares are of one cycle.
        own = [
            MessageSlot(
                frame_id=slot,
                payload_bytes=cluster.static_payload_bytes,
                node=node,
                base_cycle=base,
                repetition=repetition,
            )
            for node, (base, slots) in enumerate(groups[:nodes])
            for slot in slots
        ]
        others = [
            msgspec.structs.replace(slot, node=nodes + place) for place, slot in enumerate(seen)
        ]
        age_us = repetition * cluster.cycle_us + share_overhead_us(cluster, len(frames))
        slots = checked_slots((*own, *others), cluster)
        return SpareSlots(unused, repetition, len(frames), age_us, slots)
    raise ValueError(
        f"the free static slots hold {fit_most} nodes with shares of {share_bytes} bytes "
        f"({len(frames)} frames each), not {nodes}; use fewer --nodes or shorter shares "
        "(--number float32), or dynamic slots (`concord flexray plan --cluster ...`)"
    )
