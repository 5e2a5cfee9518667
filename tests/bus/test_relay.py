"""Relaying within a cycle: allowed where the bus leaves a host the time, refused elsewhere."""

from itertools import pairwise

import msgspec
import pytest

from concord.bus.flexray.fitted import fitted_cluster
from concord.bus.flexray.slot_table import allocate
from concord.bus.flexray.timing import (
    check_relay,
    dynamic_transmissions,
    least_gap_us,
    static_transmissions,
)
from concord.bus.schedule import Group, dynamic_only, full_publish, hybrid

PAYLOADS = (40,)


def relaying(schedule):
    return msgspec.structs.replace(schedule, relay=True)


@pytest.mark.parametrize(
    "schedule", [full_publish(5), hybrid(6, 0.7), dynamic_only(6, 0.5)], ids=str
)
def test_the_gap_is_what_the_timetable_leaves_at_least(schedule):
    cluster = fitted_cluster(schedule, PAYLOADS)
    table = allocate(schedule, cluster, PAYLOADS, PAYLOADS)
    frames = [*static_transmissions(cluster, table.static_slots(0))]
    requests = [table.request(node) for node in schedule.contenders(0)]
    segments = [frames]
    if requests:
        # Frames of all lengths, next to each other.
        for size in range(2, 41, 2):
            shorter = [request._replace(payload_bytes=size) for request in requests[:2]]
            segments.append([*dynamic_transmissions(cluster, shorter)])
    gaps = [
        later.start_us - earlier.end_us for some in segments for earlier, later in pairwise(some)
    ]
    least = least_gap_us(schedule, cluster)
    assert min(gaps) >= least - 1e-9
    # Nor is it pessimistic by more than a minislot.
    assert min(gaps) - least < cluster.minislot_us + 1e-9
    check_relay(schedule, cluster, table, least)
    with pytest.raises(ValueError, match="leave --relay out"):
        check_relay(schedule, cluster, table, least + 0.1)


def test_a_segment_too_short_for_some_winners_is_refused():
    schedule = dynamic_only(6, 0.5)
    wide = fitted_cluster(dynamic_only(6, 1.0), PAYLOADS)
    table = allocate(schedule, wide, (), PAYLOADS)
    check_relay(schedule, wide, table, 1.0)
    tight = fitted_cluster(dynamic_only(6, 0.3), PAYLOADS)
    with pytest.raises(ValueError, match="holds 2 of 3"):
        check_relay(schedule, tight, allocate(schedule, tight, (), PAYLOADS), 1.0)


def test_each_slot_is_a_part_of_its_own():
    schedule = relaying(hybrid(6, 0.7))
    assert schedule.groups(0)[-1] == Group((), 1)
    senders = [node for group in schedule.groups(0) for node in group.senders]
    assert tuple(senders) == schedule.static_senders(0)
    assert sum(group.dynamic_slots for group in schedule.groups(0)) == schedule.dynamic_slots(0)


def test_hybrid_takes_its_owners_from_an_order():
    schedule = hybrid(5, 0.8, order=[4, 2, 0, 1, 3])
    assert {node for row in schedule.static_table for node in row} == {0, 2, 4}
    assert schedule.contender_table == ((1, 3),)
    assert hybrid(5, 0.8, order=range(5)) == hybrid(5, 0.8)
