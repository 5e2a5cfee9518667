"""Waveforms that are made: decoded to the frames that were sent, with the lengths of the rules."""

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.bus import Captured
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import Request, walk
from concord.bus.flexray.frame import Frame, encode
from concord.bus.flexray.presets import AUDI, FLEXRAY_ADAPTER
from concord.features.flexray_tools.recordings.decoder import decode_waveform, reencodes
from concord.features.flexray_tools.recordings.transmitted import transmitted
from concord.features.flexray_tools.recordings.waveform import WaveformError

SLOW = msgspec.structs.replace(
    AUDI, bit_rate_mbps=5.0, static_payload_words=2, dynamic_payload_words=20,
    latest_transmission_minislot=200,
)  # fmt: skip


@st.composite
def cycles(draw: st.DrawFn) -> tuple[Cluster, list[Captured]]:
    """Frames of one cycle in some static slots, and of requests that fit the dynamic segment."""
    cluster = draw(st.sampled_from([AUDI, FLEXRAY_ADAPTER, SLOW]))
    sent: list[Captured] = []
    for slot in draw(st.sets(st.integers(1, cluster.static_slots), min_size=1, max_size=6)):
        payload = draw(st.binary(min_size=cluster.static_payload_bytes,
                                 max_size=cluster.static_payload_bytes))  # fmt: skip
        begin_us = cluster.slot_start_us(slot) + cluster.action_point_us
        sent.append(Captured(begin_us, encode(Frame(slot, 7, payload))))
    places = draw(st.sets(st.integers(0, 30), max_size=5))
    requests = [
        Request(0, cluster.first_dynamic_id + place, 2 * draw(st.integers(0, 8)))
        for place in places
    ]
    for frame in walk(cluster, requests).placed:
        begin_us = cluster.minislot_start_us(frame.minislot) + cluster.minislot_action_point_us
        data = encode(Frame(frame.frame_id, 7, bytes(frame.payload_bytes)))
        sent.append(Captured(begin_us, data))
    return cluster, sorted(sent, key=lambda one: one.time_us)


@settings(max_examples=60)
@given(cycles())
def test_a_waveform_decodes_to_the_frames_that_were_sent(made: tuple[Cluster, list[Captured]]):
    cluster, sent = made
    decoding = decode_waveform(transmitted(sent, cluster))
    assert [frame.data for frame in decoding.frames] == [one.data for one in sent]
    assert decoding.bit_rate_mbps == cluster.bit_rate_mbps and not decoding.rejected
    assert decoding.glitches == 0
    assert all(reencodes(frame, "A") for frame in decoding.frames)
    for frame, one in zip(decoding.frames, sent, strict=True):
        assert frame.start_us == pytest.approx(one.time_us, abs=1e-3)
        assert frame.end_us - frame.start_us == pytest.approx(
            cluster.frame_us(len(frame.frame.payload)), abs=2e-3
        )
        # A trailing sequence ends at an action point, so it has a whole number of minislots.
        if frame.frame.frame_id >= cluster.first_dynamic_id:
            minislots = cluster.dynamic_slot_minislots(len(frame.frame.payload)) - 1
            minislots -= cluster.dynamic_slot_idle_phase_minislots
            busy_us = frame.end_us - frame.start_us + frame.trailing_us
            assert busy_us == pytest.approx(minislots * cluster.minislot_us, abs=2e-3)


def test_frames_on_top_of_each_other_are_refused():
    frame = encode(Frame(5, 0, bytes(34)))
    with pytest.raises(WaveformError, match=r"frame 5 begins at 20 us, .* send it later"):
        transmitted([Captured(0.0, frame), Captured(20.0, frame)], AUDI)
    with pytest.raises(WaveformError, match="no frame is sent"):
        transmitted([], AUDI)
