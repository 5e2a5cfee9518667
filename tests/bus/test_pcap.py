"""Capture files: read back by hand, and by Wireshark's own dissector."""

import shutil
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.bus import Captured, file_header
from concord.bus.flexray.frame import Channel, Frame, encode
from concord.bus.pcap import (
    LINK_TYPE_FLEXRAY,
    CapturedSymbol,
    packet,
    write_pcap,
)
from tests.bus.support import frames, quick
from tests.experiments.command_support import dissect

needs_tshark = pytest.mark.skipif(
    shutil.which("tshark") is None, reason="tshark is not installed (apt-get install tshark)"
)


@quick
@given(frames(), st.sampled_from("AB"), st.floats(0, 1e12))
def test_a_packet_is_headers_and_the_frame_without_its_crc(frame: Frame, channel, time_us):
    data = encode(frame, channel)
    record = packet(Captured(time_us, data, channel))
    seconds, nanoseconds, stored, original = struct.unpack("<IIII", record[:16])
    assert abs(seconds * 1e9 + nanoseconds - time_us * 1e3) < 1 + time_us * 1e-9
    assert nanoseconds < 1_000_000_000
    assert stored == original == len(record) - 16
    assert record[16] == (0x81 if channel == "B" else 0x01)
    assert record[17] == 0
    assert record[18:] == data[:-3]


def test_file_header_has_the_link_type_of_flexray():
    magic, major, minor, *_, link_type = struct.unpack("<IHHiIII", file_header(LINK_TYPE_FLEXRAY))
    assert (magic, major, minor, link_type) == (0xA1B23C4D, 2, 4, 210)


def flipped(data: bytes, bit: int) -> bytes:
    return (int.from_bytes(data, "big") ^ 1 << 8 * len(data) - 1 - bit).to_bytes(len(data), "big")


def test_error_flags_tell_header_from_frame_crc():
    good = encode(Frame(7, 3, b"abcd"))
    assert packet(Captured(0, flipped(good, 10)))[17] == 0x18
    assert packet(Captured(0, flipped(good, 50)))[17] == 0x10
    assert packet(Captured(0, good, "B"))[17] == 0x10
    assert packet(Captured(0, good[:4]))[17:] == b"\x02" + good[:4]


def test_a_symbol_is_its_kind_and_its_low_bits():
    assert packet(CapturedSymbol(0, 39))[16:] == bytes((0x02, 39))
    assert packet(CapturedSymbol(0, 600, "B"))[16:] == bytes((0x82, 127))


@needs_tshark
def test_wireshark_sees_what_was_sent(tmp_path: Path):
    sent: list[tuple[Frame, Channel]] = [
        (Frame(1, 0, bytes(range(160)), sync=True, startup=True), "A"),
        (Frame(2047, 63, bytes(254)), "B"),
        (Frame(300, 17, b""), "A"),
        (Frame(9, 5, bytes(34), null=True), "A"),
        (Frame(10, 6, b"ab", payload_preamble=True), "B"),
    ]
    good = [
        Captured(1000.5 * place, encode(frame, channel), channel)
        for place, (frame, channel) in enumerate(sent)
    ]
    # A wrong bit in the payload, and one in the sync indicator, which both checksums guard.
    bad = [
        good[0]._replace(data=flipped(good[0].data, 99)),
        good[0]._replace(data=flipped(good[4].data, 3)),
    ]
    path = tmp_path / "bus.pcap"
    assert write_pcap(path, [*good, *bad]) == 7
    rows = dissect(
        path,
        "flexray.fid",
        "flexray.cc",
        "flexray.pl",
        "flexray.ch",
        "flexray.nfi",
        "flexray.sfi",
        "flexray.stfi",
        "flexray.ppi",
        "flexray.fcrc_err",
        "flexray.hcrc_err",
        "data.data",
        "frame.time_epoch",
        "_ws.malformed",
    )
    assert len(rows) == 7
    for row, (frame, channel), captured in zip(rows, sent, good, strict=False):
        assert row[:3] == [
            str(frame.frame_id),
            str(frame.cycle_count),
            str(len(frame.payload) // 2),
        ]
        expected = [channel == "B", not frame.null, frame.sync, frame.startup]
        expected += [frame.payload_preamble, False, False]
        assert [value in ("1", "True") for value in row[3:10]] == expected
        assert row[10] == frame.payload.hex()
        assert float(row[11]) == pytest.approx(captured.time_us / 1e6, abs=1e-9)
        assert row[12] == ""
    assert [[value in ("1", "True") for value in row[8:10]] for row in rows[5:]] == [
        [True, False],
        [True, True],
    ]


@needs_tshark
def test_wireshark_reads_a_symbol(tmp_path: Path):
    path = tmp_path / "symbol.pcap"
    write_pcap(path, [CapturedSymbol(0, 39)])
    assert dissect(path, "flexray.sl", "_ws.malformed") == [["39", ""]]
