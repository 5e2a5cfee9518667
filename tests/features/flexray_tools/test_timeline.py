"""Recorded frames beside the model of their times, in Wireshark, and a cycle drawn as text."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.bus import Captured
from concord.bus.flexray.dynamic_segment import Request
from concord.bus.flexray.frame import encode
from concord.bus.flexray.presets import AUDI
from concord.bus.flexray.slot_table import SlotAssignment
from concord.bus.flexray.timing import dynamic_transmissions, static_transmissions
from concord.bus.pcap import write_pcap
from concord.features.flexray_tools.recordings.decoder import Decoding
from concord.features.flexray_tools.timeline import BAR_COLUMNS, timeline
from tests.bus.support import dynamic_segments, quick, served
from tests.experiments.command_support import dissect, needs_tshark


def test_recorded_frames_are_where_the_model_puts_them(audi: Decoding):
    """Every frame of the car's bus, static and dynamic, within half a microsecond."""
    for cycle in range(28, 36):
        frames = [f for f in audi.frames if f.frame.cycle_count == cycle]
        static = [f for f in frames if audi.segment(f) == "static"]
        dynamic = [f for f in frames if audi.segment(f) == "dynamic"]
        model = static_transmissions(AUDI, [SlotAssignment(f.frame.frame_id, 0) for f in static])
        model += dynamic_transmissions(
            AUDI, [Request(0, f.frame.frame_id, len(f.frame.payload)) for f in dynamic]
        )
        assert len(model) == len(frames)
        offsets = [f.start_us - m.start_us for f, m in zip(frames, model, strict=True)]
        assert max(offsets) - min(offsets) < 1.0
        for recorded, modelled in zip(frames, model, strict=True):
            length_us = recorded.end_us - recorded.start_us
            assert length_us == pytest.approx(modelled.end_us - modelled.start_us, abs=0.3)


@needs_tshark
def test_wireshark_opens_the_recording_of_the_car_without_complaint(audi: Decoding, tmp_path: Path):
    path = tmp_path / "car.pcap"
    write_pcap(path, (Captured(f.start_us, encode(f.frame)) for f in audi.frames))
    rows = dissect(path, "flexray.fid", "flexray.cc", "flexray.eff", "_ws.malformed", "_ws.expert")
    assert [(int(row[0]), int(row[1])) for row in rows] == [
        (f.frame.frame_id, f.frame.cycle_count) for f in audi.frames
    ]
    assert all(int(row[2], 16) == 0 and row[3:] == ["", ""] for row in rows)


@quick
@given(dynamic_segments(), st.integers(0, 200))
def test_the_timeline_shows_every_frame_once_in_order_of_time(segment, cycle):
    cluster, requests = segment
    winners = served(cluster, requests)
    frames = dynamic_transmissions(cluster, winners) + static_transmissions(
        cluster, [SlotAssignment(2, 5, cluster.channels), SlotAssignment(1, 4, cluster.channels)]
    )
    text = timeline(cluster, cycle, frames)
    heading, _, *rows = text.splitlines()
    assert f"cycle {cycle} (count {cycle % cluster.number_of_cycles})" in heading
    assert len({len(row) for row in rows}) == 1
    assert all(row[-BAR_COLUMNS - 2] == row[-1] == "|" for row in rows)
    shown = [int(row.split("ID ")[1].split()[0]) for row in rows if "ID " in row]
    assert shown == [1, 2, *sorted(frame.frame_id for frame in frames if frame.frame_id > 2)]
    starts = [float(row.split()[0]) for row in rows]
    assert starts == sorted(starts)
