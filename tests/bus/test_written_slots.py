"""Written slot tables as schedules: whose slot is when, other stations, and mistakes by name."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot, Request, walk
from concord.bus.flexray.flexray_bus import FlexRayBus, flexray_bus
from concord.bus.flexray.presets import AUDI, BOSCH
from concord.bus.flexray.written_slots import message_slots, written_bus, written_schedule
from concord.bus.schedule import full_publish, hybrid, round_robin

SHARE_BYTES = 24


def bus_of(slots: list[MessageSlot], nodes: int, cluster: Cluster = AUDI) -> FlexRayBus:
    schedule = written_schedule(slots, cluster, nodes)
    return written_bus(slots, cluster, schedule, SHARE_BYTES, ARBITERS["minislot"])


@st.composite
def turns(draw: st.DrawFn) -> list[MessageSlot]:
    """Static slots in which nodes take turns, and a dynamic slot for each of some other nodes."""
    made: list[MessageSlot] = []
    node = 0
    for frame_id in range(1, draw(st.integers(1, 4)) + 1):
        repetition = draw(st.sampled_from([1, 2, 4]))
        for base in range(repetition):
            made.append(MessageSlot(frame_id=frame_id, payload_bytes=34, node=node,
                                    base_cycle=base, repetition=repetition))  # fmt: skip
            node += 1
    for place in range(draw(st.integers(0, 3))):
        repetition = draw(st.sampled_from([1, 2, 8]))
        base = draw(st.integers(0, repetition - 1))
        made.append(MessageSlot(frame_id=52 + place, payload_bytes=80, node=node,
                                base_cycle=base, repetition=repetition))  # fmt: skip
        node += 1
    return made


@given(turns())
def test_a_node_publishes_in_exactly_the_cycles_of_its_slots(slots: list[MessageSlot]):
    nodes = len(slots)
    bus = bus_of(slots, nodes)
    for cycle in range(130):
        due = [slot for slot in slots if cycle % slot.repetition == slot.base_cycle]
        static = [slot.node for slot in due if slot.frame_id <= 51]
        assert list(bus.schedule.static_senders(cycle)) == static
        asking = [slot.node for slot in due if slot.frame_id > 51]
        assert list(bus.schedule.contenders(cycle)) == asking
        owned = {slot.node: slot.frame_id for slot in due}
        for node in range(nodes):
            ids = [slot.frame_id for of_class in bus.slots(node, cycle) for slot in of_class]
            assert ids == ([owned[node]] if node in owned else [])


@pytest.mark.parametrize("made", [full_publish(6), round_robin(8, 2), hybrid(8, 0.5)])
def test_the_slots_of_a_schedule_are_handed_back_and_taken_again(made):
    first = flexray_bus(made, BOSCH, SHARE_BYTES, ARBITERS["minislot"])
    slots = message_slots(first.table, BOSCH)
    again = bus_of(list(slots), made.nodes, BOSCH)
    for cycle in range(64):
        assert again.schedule.static_senders(cycle) == made.static_senders(cycle)
        assert again.schedule.contenders(cycle) == made.contenders(cycle)
        for node in range(made.nodes):
            assert again.slots(node, cycle) == first.slots(node, cycle)
    assert message_slots(again.table, BOSCH) == slots


def test_turns_that_no_controller_repeats_are_not_written():
    bus = flexray_bus(round_robin(9, 2), BOSCH, SHARE_BYTES, ARBITERS["minislot"])
    with pytest.raises(ValueError, match=r"cannot be written: slot 1 changes owner .* 9 cycles"):
        message_slots(bus.table, BOSCH)


@settings(max_examples=40)
@given(st.lists(st.integers(1, 127), min_size=1, max_size=9), st.integers(1, 30))
def test_other_stations_go_first_and_shares_take_the_room_that_is_left(words: list[int], gap: int):
    others = [
        MessageSlot(frame_id=52 + place, payload_bytes=2 * size, node=100 + place)
        for place, size in enumerate(words)
    ]
    first = 52 + len(words) + gap
    mine = [MessageSlot(frame_id=first + i, payload_bytes=80, node=i) for i in range(3)]
    bus = bus_of([*others, *mine], 3)
    theirs = [Request(slot.node, slot.frame_id, slot.payload_bytes) for slot in others]
    sizes = [sum(slot.payload_bytes for slot in bus.slots(node, 0)[0]) for node in range(3)]
    shares = [Request(node, first + node, size) for node, size in enumerate(sizes)]

    def placed_of(some: Sequence[Request]) -> dict[int, int]:
        return {frame.node: frame.minislot for frame in walk(AUDI, [*theirs, *some]).placed}

    rooms = [
        count
        for count in range(4)
        if all(
            {share.node for share in some} <= placed_of(some).keys()
            for some in combinations(shares, count)
        )
    ]
    assert bus.dynamic_room() == max(rooms)
    placed = placed_of(shares)
    fitting = [node for node in range(3) if node in placed]
    sent = bus.transmissions(0, [size if i in fitting else 0 for i, size in enumerate(sizes)])
    assert {frame.node: frame.minislot for frame in sent} == {i: placed[i] for i in fitting}
    used_us = sum(AUDI.frame_us(2 * size) for size in words)
    assert bus.other_load == pytest.approx(used_us / AUDI.cycle_us)


def test_multiplexed_stations_delay_shares_in_their_own_cycles_only():
    other = MessageSlot(frame_id=52, payload_bytes=200, node=7, base_cycle=1, repetition=2)
    bus = bus_of([other, MessageSlot(frame_id=60, payload_bytes=80, node=0)], 1)
    starts = [bus.transmissions(cycle, [40])[0].start_us for cycle in range(3)]
    longer = AUDI.dynamic_slot_minislots(200) - 1
    assert starts[0] == starts[2]
    assert starts[1] - starts[0] == pytest.approx(longer * AUDI.minislot_us)


def test_a_segment_that_others_fill_leaves_shares_waiting():
    others = [MessageSlot(frame_id=52 + i, payload_bytes=254, node=9 + i) for i in range(9)]
    bus = bus_of([*others, MessageSlot(frame_id=70, payload_bytes=80, node=0)], 1)
    assert bus.dynamic_room() == 0


SLOT: dict[str, Any] = {"frame_id": 1, "payload_bytes": 34, "node": 0}


@pytest.mark.parametrize(
    ("slots", "nodes", "said"),
    [
        ([{}], 3, "nodes 1, 2 of 3 own no slot; give each node a slot"),
        ([{}, {"frame_id": 60, "payload_bytes": 80}], 1, "static and dynamic slots in cycle 0"),
        ([{"frame_id": 60, "payload_bytes": 4}], 1, "payload_bytes is 4, but a share needs 32"),
        ([{"channel": "B"}], 1, 'set channel = "A"'),
        (
            [{"frame_id": 60, "payload_bytes": 80, "repetition": 2},
             {"frame_id": 60, "payload_bytes": 80, "node": 5, "base_cycle": 1, "repetition": 2}],
            1, "station 5 takes turns with a node",
        ),
        ([{"frame_id": 300, "payload_bytes": 80}], 1, "could never send"),
    ],
)  # fmt: skip
def test_tables_that_cannot_carry_the_shares_are_refused_with_a_cure(slots, nodes, said):
    made = [MessageSlot(**{**SLOT, **slot}) for slot in slots]
    with pytest.raises(ValueError, match=said):
        bus_of(made, nodes)


def test_a_share_of_several_frames_needs_slots_of_its_own_for_each():
    narrow = msgspec.structs.replace(AUDI, static_payload_words=8)
    one = MessageSlot(**{**SLOT, "payload_bytes": 16})
    with pytest.raises(ValueError, match=r"node 0 owns 1 static slot in cycle 0, .* 3 frames"):
        bus_of([one], 1, narrow)
    three = [msgspec.structs.replace(one, frame_id=i) for i in (3, 7, 9)]
    bus = bus_of(three, 1, narrow)
    assert [slot.frame_id for slot in bus.slots(0, 0)[0]] == [3, 7, 9]
    sizes = np.array([slot.payload_bytes for slot in bus.slots(0, 0)[0]])
    assert [frame.frame_id for frame in bus.transmissions(0, [int(sizes.sum())])] == [3, 7, 9]
