"""Channels A and B as two buses: slots, slot counters, room, and slot tables by hand."""

from collections import defaultdict

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS, begin_arbitration
from concord.bus.bus import Rejected
from concord.bus.flexray.channels.plan import CHANNEL_PLANS, channel_plan, static_places
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.fitted import fitted_cluster
from concord.bus.flexray.flexray_bus import FlexRayBus, flexray_bus
from concord.bus.flexray.presets import AUDI, DEMO
from concord.bus.flexray.share_frames import payload_lengths, read_frame
from concord.bus.flexray.written_slots import message_slots, written_bus, written_schedule
from concord.bus.schedule import Schedule, dynamic_only, full_publish, hybrid, round_robin

SHARE_BYTES = 60
PLANS = ["all", *CHANNEL_PLANS]
AUDI_AB = msgspec.structs.replace(AUDI, channels="AB")


def bus_of(
    schedule: Schedule, name: str, arbiter: str = "minislot", cluster: Cluster | None = None
) -> FlexRayBus:
    """A bus of both channels on which frames go by the plan of this name."""
    plan = channel_plan(name, "AB", "both")
    if cluster is None:
        fitted = fitted_cluster(schedule, payload_lengths(SHARE_BYTES), plan=plan)
        cluster = msgspec.structs.replace(fitted, channels="AB")
    return flexray_bus(schedule, cluster, SHARE_BYTES, ARBITERS[arbiter], plan=plan)


SCHEDULES = st.one_of(
    st.builds(full_publish, st.integers(1, 12)),
    st.builds(lambda n, k: round_robin(n, min(n, k)), st.integers(1, 12), st.integers(1, 12)),
    st.builds(hybrid, st.integers(2, 12), st.sampled_from([0.3, 0.6, 1.0])),
    st.builds(dynamic_only, st.integers(1, 12), st.sampled_from([0.3, 1.0])),
)


@given(SCHEDULES, st.sampled_from(PLANS))
def test_each_slot_of_a_channel_has_one_owner_and_sync_frames_are_on_both(
    schedule: Schedule, name: str
):
    bus = bus_of(schedule, name)
    for cycle in range(schedule.period):
        owners: dict[tuple[int, str], int] = {}
        for slot in bus.table.assignments:
            if slot.sends(cycle):
                for letter in slot.channel:
                    assert owners.setdefault((slot.frame_id, letter), slot.node) == slot.node
    used = {letter for slot in bus.table.assignments for letter in slot.channel}
    assert used <= set("AB" if name in ("all", "split", "mixed") else name)
    channels = {
        slot.channel
        for node in range(schedule.nodes)
        for of_class in bus.slots(node, 0)
        for slot in of_class
        if slot.sync
    }
    assert all(set(one) == used for one in channels)


@given(st.integers(4, 40), st.integers(0, 2**32 - 1))
def test_a_channel_counts_as_a_bus_of_its_own(nodes: int, seed: int):
    """Of a split dynamic segment each channel is the bus of every other node, and of no other."""
    random = np.random.default_rng(seed)
    both = bus_of(dynamic_only(nodes, 1.0), "split", cluster=AUDI_AB)
    sizes = [int(random.integers(0, 2)) * len(both.encode(i, 0, b"")[0]) for i in range(nodes)]
    frames = both.transmissions(0, sizes)
    for place, letter in enumerate("AB"):
        half = range(place, nodes, 2)
        alone = bus_of(dynamic_only(len(half), 1.0), "A", cluster=AUDI_AB)
        of_half = alone.transmissions(0, [sizes[node] for node in half])
        mine = [one for one in frames if one.channel == letter]
        assert [(one.node, one.frame_id, one.start_us) for one in mine] == [
            (half[one.node], one.frame_id, one.start_us) for one in of_half
        ]
        assert both.load(mine) == alone.load(of_half)
    assert len(frames) == sum(size > 0 for size in sizes)


def winners(bus: FlexRayBus, cycles: int = 1) -> list[int]:
    """How often each contender wins while all ask for their longest shares."""
    nodes = list(bus.schedule.contenders(0))
    state, won = begin_arbitration(bus.schedule.nodes), np.zeros(len(nodes), int)
    sizes = np.array([sum(bus.payloads(node, 0, SHARE_BYTES)) for node in nodes])
    for cycle in range(cycles):
        state, wins, *_ = bus.arbitrate(
            state, cycle, 0, nodes, np.ones(len(nodes), int), lambda: sizes
        )
        won += wins
    return won.tolist()


def test_two_channels_apart_carry_twice_the_contenders():
    schedule = dynamic_only(90, 1.0)
    sent = {name: sum(winners(bus_of(schedule, name, cluster=AUDI_AB))) for name in PLANS}
    assert sent["all"] == sent["A"] == sent["B"] < 45
    assert sent["split"] == sent["mixed"] == 2 * sent["all"]
    room = {name: bus_of(schedule, name, cluster=AUDI_AB).dynamic_room() for name in PLANS}
    assert 0 < room["all"] == room["A"]
    # Half as many frame IDs before the last leave minislots for more frames.
    assert room["split"] > room["all"]


def test_the_arbiter_of_turns_serves_both_channels():
    """Two nodes have each frame ID; an order by frame ID alone would starve one of them."""
    bus = bus_of(dynamic_only(8, 1 / 8), "split", "round-robin")
    assert winners(bus, 16) == [2] * 8


def test_a_frame_of_one_channel_is_no_frame_of_the_other():
    bus = bus_of(full_publish(6), "split")
    of_slot = defaultdict(list)
    for node in range(6):
        (slot,) = bus.slots(node, 0)[0]
        of_slot[slot.frame_id].append(node)
        assert bus.place(node, read_frame(bus.encode(node, 0, b"x")[0])).channels == slot.channel
    pairs = [nodes for nodes in of_slot.values() if len(nodes) == 2]
    assert len(pairs) == 1 and len(of_slot) == 5
    for sender, other in (pairs[0], pairs[0][::-1]):
        body = b"body"
        (frame,) = bus.encode(sender, 0, body)
        assert bus.due_body(frame, sender, 0, len(body)) == body
        assert bus.due_body(frame, other, 0, len(body)) is None
        with pytest.raises(Rejected, match="wrong-slot"):
            bus.place(other, bus.receive(frame))
        moved = bus.in_slot_of(frame, other, 0)
        assert moved is not None and bus.place(other, bus.receive(moved)).number == 0


def test_key_slots_that_a_cluster_states_are_on_both_channels():
    places = static_places(full_publish(7), 1, CHANNEL_PLANS["split"], key_slots=(2, 4))
    assert places == ((1, "A"), (2, "AB"), (3, "A"), (4, "AB"), (5, "A"), (5, "B"), (6, "A"))
    # Nodes that take turns in a place have no key slot there.
    turns = static_places(round_robin(4, 2), 2, CHANNEL_PLANS["split"], key_slots=(1,))
    assert turns == ((1, "A"), (1, "B"))


def test_a_cluster_without_a_channel_of_the_plan_is_refused():
    with pytest.raises(ValueError, match=r"--channels split: .* 'audi' has channel A alone"):
        channel_plan("split", "A", "audi")
    assert channel_plan("A", "A", "audi") == CHANNEL_PLANS["A"]


def slot(frame_id: int, node: int, channel: str, **more: int) -> MessageSlot:
    return msgspec.convert(
        {"frame_id": frame_id, "node": node, "channel": channel, "payload_bytes": 80, **more},
        MessageSlot,
    )


def written(slots: list[MessageSlot], nodes: int) -> FlexRayBus:
    schedule = written_schedule(slots, AUDI_AB, nodes)
    return written_bus(slots, AUDI_AB, schedule, 24, ARBITERS["minislot"])


def test_a_written_table_gives_each_frame_its_channel():
    static = [slot(1, 0, "A", payload_bytes=34), slot(1, 1, "B", payload_bytes=34),
              slot(2, 2, "AB", payload_bytes=34)]  # fmt: skip
    bus = written([*static, slot(60, 3, "A"), slot(60, 4, "B"), slot(61, 9, "B")], 5)
    frames = bus.transmissions(0, [34, 34, 34, 80, 80])
    assert [(one.node, one.channel) for one in frames] == [
        (0, "A"), (1, "B"), (2, "AB"), (3, "A"), (4, "B"),
    ]  # fmt: skip
    assert frames[3].start_us == frames[4].start_us
    # The table that is handed back is the same, but for what a share leaves of a dynamic frame.
    again = message_slots(bus.table, AUDI_AB)
    assert [(one.frame_id, one.node, one.channel) for one in again][:5] == [
        (1, 0, "A"), (1, 1, "B"), (2, 2, "AB"), (60, 3, "A"), (60, 4, "B"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("slots", "said"),
    [
        ([slot(60, 0, "A"), slot(60, 0, "B")], "write one entry with channel"),
        ([slot(60, 0, "AB"), slot(61, 1, "B")], "count to the first at different times"),
    ],
)
def test_a_table_that_two_counters_cannot_follow_is_refused(slots: list[MessageSlot], said: str):
    with pytest.raises(ValueError, match=said):
        written(slots, len({one.node for one in slots}))


def test_a_demo_cluster_holds_twice_the_static_senders():
    demo = msgspec.structs.replace(DEMO, channels="AB")
    with pytest.raises(ValueError, match="needs 37 static slots"):
        bus_of(full_publish(37), "all", cluster=demo)
    # Three startup nodes send on both channels, so 20 slots hold 37 nodes.
    bus = bus_of(full_publish(37), "split", cluster=demo)
    assert max(one.frame_id for one in bus.table.assignments) == 20
    with pytest.raises(ValueError, match="needs 21 static slots"):
        bus_of(full_publish(38), "split", cluster=demo)
