"""A cluster made to measure: the shortest cycle that holds what a schedule sends."""

from collections.abc import Sequence

from concord.bus.bus import TooLong
from concord.bus.flexray.channels.plan import (
    ChannelPlan,
    contender_groups,
    on_all,
    static_places,
)
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.presets import DEMO
from concord.bus.schedule import Schedule

_MIN_STATIC_SLOTS = 2
_MIN_STATIC_PAYLOAD_BYTES = 2
_IDLE_MACROTICKS = 40
# Of 1 us, in the longest cycle of FlexRay.
_MOST_MACROTICKS = 16_000


def fitted_cluster(
    schedule: Schedule, payloads: Sequence[int], classes: int = 1, plan: ChannelPlan | None = None
) -> Cluster:
    """The cluster with macroticks of 1 us and the action points of the demo cluster, in which every
    static turn of `schedule` has its slots and every choice of winners fits the dynamic segment.

    Args:
        schedule: which node publishes when.
        payloads: payload length in bytes of each frame that a share takes, all but the last full.
        classes: urgency classes, in each of which a contender has frame IDs of its own.
        plan: channels of the shares; None: every share is on all channels.

    Raises:
        TooLong: no FlexRay cycle (16 ms at most) is long enough.
        ClusterError: it has more slots than a cluster may have.
    """
    turns = max(len(row) for row in schedule.static_table)
    plan = plan or on_all(DEMO.channels)
    places = static_places(schedule, len(payloads), plan)
    needed = max((one.first_id + len(payloads) - 1 for one in places), default=0)
    static_slots = max(_MIN_STATIC_SLOTS, needed)
    static_payload_bytes = max(payloads) if turns else _MIN_STATIC_PAYLOAD_BYTES
    slot_macroticks = DEMO.static_frame_macroticks(static_payload_bytes)

    asking = sorted({node for row in schedule.contender_table for node in row})
    contenders = max(len(members) for _, members in contender_groups(asking, plan))
    winners = min(max(schedule.dynamic_slot_table), contenders)
    lengths = [DEMO.dynamic_slot_minislots(size) for size in payloads]
    # The worst case: the winners are on one channel and have the last IDs, and every slot before
    # them counts by empty.
    minislots = (contenders * classes - winners) * len(payloads) + winners * sum(lengths)
    # pLatestTx keeps room for the longest frame of a node with a slow clock, whatever is sent last.
    longest = DEMO.dynamic_slot_most_minislots(max(payloads))
    minislots += (longest - lengths[-1]) if minislots else 0
    macroticks = (
        static_slots * slot_macroticks + minislots * DEMO.minislot_macroticks + _IDLE_MACROTICKS
    )
    if macroticks > _MOST_MACROTICKS:
        raise TooLong(f"they take {macroticks / 1e3:.1f} ms")
    return Cluster(
        name="fitted",
        cycle_us=float(macroticks),
        macroticks_per_cycle=macroticks,
        macrotick_us=DEMO.macrotick_us,
        microtick_us=DEMO.microtick_us,
        microticks_per_cycle=round(macroticks / DEMO.microtick_us),
        static_slots=static_slots,
        static_slot_macroticks=slot_macroticks,
        action_point_macroticks=DEMO.action_point_macroticks,
        static_payload_words=static_payload_bytes // 2,
        minislots=minislots,
        minislot_macroticks=DEMO.minislot_macroticks,
        minislot_action_point_macroticks=DEMO.minislot_action_point_macroticks,
        dynamic_payload_words=max(payloads) // 2,
        latest_transmission_minislot=max(0, minislots - longest + 1) if minislots else 0,
        network_idle_time_macroticks=_IDLE_MACROTICKS,
    )
