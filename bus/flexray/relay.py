"""Whether a host can send on, in its slot, what the slot before has just brought."""

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import walk
from concord.bus.flexray.slot_table import SlotTable
from concord.bus.schedule import Schedule


def check_relay(
    schedule: Schedule, cluster: Cluster, table: SlotTable, latch_delay_us: float
) -> None:
    """Refuse relaying within a cycle on a cluster that leaves no time for it.

    A host can relay if it needs no longer than `latch_delay_us` from the last bit of a frame to
    having composed the next, which may begin in the very next slot. The dynamic slots of a relaying
    schedule are awarded one by one, so every choice of winners must fit into the segment.

    Raises:
        ValueError: naming the time there is, and the cure.
    """
    time_us = least_gap_us(schedule, cluster)
    if latch_delay_us > time_us:
        raise ValueError(
            f"--relay with --latch-delay-us {latch_delay_us:g}: cluster {cluster.name!r} "
            f"leaves {time_us:.3g} us from the last bit of a frame to the first of the next, and a "
            "host must have read the one and composed the other by then; leave --relay out, or "
            "use a cluster with longer slots or minislots"
        )
    slots = max(schedule.dynamic_slot_table)
    contenders = sorted({node for row in schedule.contender_table for node in row})
    if not (slots and contenders):
        return
    # The last IDs are the worst: every slot before them counts by empty.
    requests = table.requests(table.classes - 1)
    worst = [requests[node] for node in contenders[-slots:]]
    waiting = walk(cluster, worst).waiting
    if waiting:
        raise ValueError(
            f"--relay: the dynamic segment of cluster {cluster.name!r} holds "
            f"{len(worst) - len(waiting)} of {len(worst)} of the longest shares, but slots that "
            "are awarded one by one must fit whoever wins; lower --occupancy or --payload-bytes, "
            "or use --cluster fitted"
        )


def least_gap_us(schedule: Schedule, cluster: Cluster) -> float:
    """The shortest time between two frames that may follow each other, last bit to first bit."""
    gaps: list[float] = []
    if any(schedule.static_table):
        gaps.append(cluster.static_slot_us - cluster.frame_us(cluster.static_payload_bytes))
    if any(schedule.dynamic_slot_table):
        # However long a frame is, its slot ends with the minislots in which idle is seen.
        idle = 1 + cluster.dynamic_slot_idle_phase_minislots
        gaps.append(idle * cluster.minislot_us)
    return min(gaps, default=float("inf"))
