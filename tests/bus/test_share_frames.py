import struct

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS, ONE_CLASS
from concord.bus.flexray.frame import Frame
from concord.bus.flexray.frame import decode as decode_frame
from concord.bus.flexray.frame import encode as encode_frame
from concord.bus.flexray.publication import Slot
from concord.bus.flexray.share_frames import (
    SHARE_FRAMES,
    cycle_of,
    payload_lengths,
    read_body,
    read_frame,
    to_frames,
)
from concord.bus.flexray.slotted_bus import SlottedBus
from concord.bus.schedule import full_publish
from concord.nodes.estimator import Rejected

CYCLES = st.integers(0, 2**32 - 1)
BODIES = st.binary(min_size=1, max_size=900)


def slots_for(body: bytes, first_id: int = 1, limit_bytes: int = 254) -> list[Slot]:
    lengths = payload_lengths(len(body), limit_bytes)
    return [Slot(first_id + part, length) for part, length in enumerate(lengths)]


@given(BODIES, CYCLES, st.integers(1, 2000), st.integers(12, 254))
def test_a_body_comes_back_from_its_frames(body: bytes, cycle: int, first_id: int, limit: int):
    slots = slots_for(body, first_id, limit)
    fragments = [read_frame(frame) for frame in to_frames(body, cycle, slots)]
    assert [fragment.frame_id for fragment in fragments] == [slot.frame_id for slot in slots]
    assert {fragment.cycle for fragment in fragments} == {cycle}
    assert read_body([fragment.data for fragment in fragments]) == body
    # A receiver that collects frames need not sort them.
    assert read_body([fragment.data for fragment in reversed(fragments)]) == body


@given(BODIES, CYCLES, st.integers(0, 40))
def test_a_slot_may_be_longer_than_the_share(body: bytes, cycle: int, spare: int):
    assume(len(body) < 200)
    length = min(254, slots_for(body)[0].payload_bytes + 2 * spare)
    (frame,) = to_frames(body, cycle, [Slot(5, length)])
    assert len(frame) == 5 + length + 3
    assert read_body([read_frame(frame).data]) == body


@given(BODIES, CYCLES, st.data())
@settings(max_examples=300)
def test_one_wrong_bit_is_always_noticed(body: bytes, cycle: int, data: st.DataObject):
    slots = slots_for(body)
    frames = to_frames(body, cycle, slots)
    frame = bytearray(data.draw(st.sampled_from(frames)))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    with pytest.raises(Rejected):
        read_frame(bytes(frame))


def test_every_single_wrong_bit_of_one_frame_is_noticed():
    (frame,) = to_frames(bytes(range(40)), 77, slots_for(bytes(40)))
    for bit in range(8 * len(frame)):
        wrong = bytearray(frame)
        wrong[bit // 8] ^= 1 << bit % 8
        with pytest.raises(Rejected):
            read_frame(bytes(wrong))


@given(st.binary(max_size=300))
def test_any_bytes_are_a_fragment_or_rejected(data: bytes):
    with pytest.raises(Rejected) as rejected:
        read_frame(data)
    assert rejected.value.reason
    cycle_of(data)


@given(BODIES, st.data())
def test_a_frame_cut_or_grown_is_rejected(body: bytes, data: st.DataObject):
    frame = to_frames(body, 3, slots_for(body))[0]
    cut = data.draw(st.integers(0, len(frame) - 1))
    for wrong in (frame[:cut], frame + b"\0", b"\0" + frame):
        with pytest.raises(Rejected):
            read_frame(wrong)


@given(st.lists(st.binary(max_size=30), max_size=4))
def test_any_fragments_are_a_body_or_rejected(fragments: list[bytes]):
    try:
        read_body(fragments)
    except Rejected as rejected:
        assert rejected.reason.startswith("fragment-")


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (Frame(3, 1, b"\1\0"), "too-short"),
        (Frame(3, 1, struct.pack("<I", 1), null=True), "null-frame"),
    ],
)
def test_a_sound_frame_that_is_no_share_says_why(frame: Frame, reason: str):
    with pytest.raises(Rejected) as rejected:
        read_frame(encode_frame(frame))
    assert rejected.value.reason == reason


def test_the_header_repeats_the_last_six_bits_of_the_cycle():
    for cycle in (0, 63, 64, 2**32 - 1):
        (frame,) = to_frames(b"x", cycle, slots_for(b"x"))
        assert frame[4] & 0x3F == cycle % 64
        assert cycle_of(frame) == cycle


@pytest.mark.parametrize("counts", [8, 64])
def test_the_counter_in_the_header_wraps_where_the_cluster_does(counts: int):
    number = 3 * counts + 5
    bus = SlottedBus(
        full_publish(2),
        lambda node, _: ((Slot(node + 1, 40),),),
        ARBITERS["wtod"],
        counts,
        ONE_CLASS,
    )
    (frame,) = bus.encode(1, number, b"x")
    assert decode_frame(frame).cycle_count == 5
    fragment = bus.receive(frame)
    assert (fragment.cycle, fragment.count) == (number, 5)
    assert bus.place(1, fragment).number == 0
    with pytest.raises(Rejected, match="cycle-count"):
        bus.place(1, bus.receive(SHARE_FRAMES.miscounted(frame, 1)))
