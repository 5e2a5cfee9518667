"""The walk through the dynamic segment against a counter that goes minislot by minislot."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import Request, frame_payloads, walk
from concord.bus.flexray.presets import DEMO, FLEXRAY_ADAPTER
from tests.bus.support import dynamic_segments, quick


def minislot_by_minislot(cluster: Cluster, requests: list[Request]) -> dict[int, int]:
    """First minislot of each frame ID that is sent: FlexRay's slot and minislot counters."""
    pending = {request.frame_id: request for request in requests}
    sent: dict[int, int] = {}
    slot, minislot = cluster.static_slots + 1, 1
    while minislot <= cluster.minislots and slot <= 2047:
        request = pending.get(slot)
        length = 1
        if request is not None and minislot <= cluster.latest_transmission_minislot:
            # The dynamic trailing sequence has one bit at least.
            bits = cluster.transmission_start_bits + 4 + 10 * (8 + request.payload_bytes)
            frame = math.ceil(
                bits / cluster.bit_rate_mbps / cluster.minislot_macroticks / cluster.macrotick_us
                - 1e-9
            )
            length = frame + 1 + cluster.dynamic_slot_idle_phase_minislots
            sent[slot] = minislot
        minislot += length
        slot += 1
    return sent


@quick
@given(dynamic_segments())
def test_the_walk_is_that_of_the_counters(segment: tuple[Cluster, list[Request]]):
    cluster, requests = segment
    placed, waiting = walk(cluster, requests)
    assert {frame.frame_id: frame.minislot for frame in placed} == minislot_by_minislot(
        cluster, requests
    )
    ids = {frame.frame_id for frame in placed} | {request.frame_id for request in waiting}
    assert ids == {request.frame_id for request in requests}


@quick
@given(dynamic_segments())
def test_nothing_begins_late_overlaps_or_overruns(segment: tuple[Cluster, list[Request]]):
    cluster, requests = segment
    free = 1
    for frame in walk(cluster, requests).placed:
        assert free <= frame.minislot <= cluster.latest_transmission_minislot
        free = frame.minislot + frame.minislots
        assert free - 1 <= cluster.minislots


def test_a_request_longer_than_one_frame_is_sent_whole_or_not_at_all():
    # 16-byte frames last 7 of 163 minislots, none may begin after minislot 157.
    adapter = FLEXRAY_ADAPTER
    long = Request(3, 61, 40)
    assert frame_payloads(adapter, 40) == (16, 16, 8)
    placed, waiting = walk(adapter, [long])
    assert [(frame.frame_id, frame.minislot) for frame in placed] == [(61, 1), (62, 8), (63, 15)]
    assert not waiting
    late = Request(3, 61 + 146, 40)
    assert walk(adapter, [late]).waiting == (late,)
    assert not walk(adapter, [late]).placed
    assert walk(adapter, [late._replace(payload_bytes=16)]).placed[0].minislot == 147
    # Its three slots stay silent for a minislot each, and the next node gets its turn.
    placed, waiting = walk(adapter, [late, Request(4, late.frame_id + 3, 16)])
    assert waiting == (late,)
    assert [(frame.node, frame.minislot) for frame in placed] == [(4, 150)]


@quick
@given(st.lists(st.tuples(st.integers(0, 40), st.integers(1, 70)), min_size=1, max_size=12))
def test_frame_by_frame_each_frame_goes_by_its_own_slot(shares: list[tuple[int, int]]):
    """Shares in order of their IDs: the empty slots before each, and its bytes."""
    adapter, frame_id = FLEXRAY_ADAPTER, FLEXRAY_ADAPTER.first_dynamic_id
    whole: list[Request] = []
    single: list[Request] = []
    for node, (gap, size) in enumerate(shares):
        frame_id += gap
        whole.append(Request(node, frame_id, size))
        for payload_bytes in frame_payloads(adapter, size):
            single.append(Request(node, frame_id, payload_bytes))
            frame_id += 1
    placed, waiting = walk(adapter, whole, frame_by_frame=True)
    sent = minislot_by_minislot(adapter, single)
    assert {frame.frame_id: frame.minislot for frame in placed} == sent
    late = {request.node for request in single if request.frame_id not in sent}
    assert {request.node for request in waiting} == late


def test_slots_with_two_senders_are_refused_by_name():
    with pytest.raises(ValueError, match="nodes 1 and 2 both send in dynamic slot 30"):
        walk(DEMO, [Request(1, 30, 8), Request(2, 30, 8)])
    with pytest.raises(ValueError, match="nodes 1 and 2 both send in dynamic slot 30"):
        walk(DEMO, [Request(1, 29, 300), Request(2, 30, 8)])


@pytest.mark.parametrize("frame_id", [20, 2048])
def test_ids_outside_of_the_segment_are_refused(frame_id: int):
    with pytest.raises(ValueError, match=f"frame ID {frame_id}"):
        walk(DEMO, [Request(1, frame_id, 8)])
