"""Logs of frames: captures, tables and BLF give back the frames that were written into them."""

import struct
from collections import Counter
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.bus import Captured, file_header, timed
from concord.bus.flexray.frame import Frame, encode
from concord.bus.flexray.presets import preset
from concord.bus.flexray.slot_file import slots_from_toml, slots_to_toml
from concord.bus.flexray.written_slots import written_schedule
from concord.bus.pcap import CapturedSymbol, packet, write_pcap
from concord.features.flexray_tools.frame_logs import captures, log_files
from concord.features.flexray_tools.frame_logs.captures import capture_blocks
from concord.features.flexray_tools.frame_logs.frames import channel_name, frame_of
from concord.features.flexray_tools.frame_logs.log_files import FrameLog, first_frames
from concord.features.flexray_tools.frame_logs.log_fit import fit_log, log_slots
from concord.features.flexray_tools.frame_logs.spare_slots import network_in_spare_slots
from concord.features.flexray_tools.frame_logs.tally import tallied
from concord.features.flexray_tools.recordings.csv_recording import parse_csv
from concord.features.flexray_tools.recordings.decoder import Decoding
from concord.features.flexray_tools.recordings.fit import fit
from concord.features.flexray_tools.recordings.recorded_cluster import recorded_slots
from concord.features.flexray_tools.recordings.recording_files import read_recording
from concord.features.flexray_tools.recordings.transmitted import transmitted
from tests.bus.support import frames, quick
from tests.experiments.command_support import concord, refused

CASE = Path(__file__).resolve().parents[4] / "shared/cases/network/frames.csv"
CAR = preset("audi")
SLOTS = [slot for slot in range(1, 52) if slot % 3]


def bus_of_a_car(cycles: int, without: frozenset[tuple[int, int]] = frozenset()) -> list[Captured]:
    """Cycles of static frames in two slots of three, and of dynamic ones with their periods."""
    sent: list[Captured] = []
    for cycle in range(cycles):
        start_us = cycle * CAR.cycle_us
        for slot in SLOTS:
            if (cycle, slot) in without:
                continue
            null = slot == 7 and cycle % 2 == 1
            frame = Frame(slot, cycle % 64, bytes(34), null=null, sync=slot < 3, startup=slot < 3)
            at_us = start_us + CAR.slot_start_us(slot) + CAR.action_point_us
            sent.append(Captured(at_us, encode(frame)))
        minislot = 2
        for slot, size, repetition in ((53, 20, 1), (54, 100, 4), (55, 40, 2)):
            if cycle % repetition:
                minislot += 1
                continue
            at_us = start_us + CAR.minislot_start_us(minislot) + CAR.minislot_action_point_us
            sent.append(Captured(at_us, encode(Frame(slot, cycle % 64, bytes(size)))))
            minislot += CAR.dynamic_slot_minislots(size)
    return sent


def read(data: bytes) -> tuple[list[tuple[int, str, Frame]], Counter[str]]:
    skipped: Counter[str] = Counter()
    blocks = list(capture_blocks(BytesIO(data), skipped))
    rows = [
        (time_ns, channel_name(channel), frame_of(frame_id, cycle, flags, payload))
        for block in blocks
        for time_ns, channel, frame_id, cycle, flags, payload in block.rows()
    ]
    return rows, +skipped


def pcapng(packets: list[bytes], order: str, resolution: int | None, link: int = 210) -> bytes:
    """Write bodies of packets, 1000 ticks apart, as an analyser does: with a comment between."""

    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        length = struct.pack(order + "I", len(body) + 12)
        return struct.pack(order + "I", kind) + length + body + length

    options = b""
    if resolution is not None:
        options = struct.pack(order + "HHB3x", 9, 1, resolution) + bytes(4)
    whole = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))
    whole += block(1, struct.pack(order + "HHI", link, 0, 0) + options)
    for number, body in enumerate(packets):
        head = struct.pack(order + "5I", 0, 0, 1000 * number, len(body), len(body))
        whole += block(6, head + body) + block(5, bytes(8))
    return whole


@quick
@given(st.lists(st.tuples(frames(), st.sampled_from("AB")), max_size=20), st.integers(20, 300))
def test_a_capture_gives_back_its_frames_whatever_is_read_at_a_time(sent, at_a_time):
    packets = [
        packet(Captured(1000.5 * n, encode(frame, channel), channel))
        for n, (frame, channel) in enumerate(sent)
    ]
    symbols = packet(CapturedSymbol(0, 30))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(captures, "_READ_BYTES", at_a_time)
        rows, skipped = read(file_header(210) + symbols + b"".join(packets))
    assert rows == [(1_000_500 * n, c, frame) for n, (frame, c) in enumerate(sent)]
    assert skipped == {"symbols": 1}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("resolution", "tick_ns"), [(None, 1000), (9, 1), (0x80 | 20, 954)])
def test_pcapng_of_both_byte_orders_and_any_clock(order: str, resolution, tick_ns: int):
    sent = [Frame(7, 3, b"abcd"), Frame(8, 3, b"", null=True)]
    bodies = [packet(Captured(0, encode(frame)))[16:] for frame in sent]
    rows, skipped = read(pcapng(bodies, order, resolution))
    assert [frame for _, _, frame in rows] == sent
    assert rows[1][0] == pytest.approx(1000 * tick_ns, rel=1e-3)
    assert skipped == {"blocks without frames": 2}


def test_pcap_of_the_other_byte_order_in_microseconds():
    data = encode(Frame(9, 1, b"ab"))
    body = packet(Captured(0, data))[16:]
    head = struct.pack(">IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 210)
    rows, _ = read(head + struct.pack(">IIII", 2, 7, len(body), len(body)) + body)
    assert rows == [(2_000_007_000, "A", Frame(9, 1, b"ab"))]


def test_wrong_checksums_cut_packets_and_other_packets_are_told(tmp_path: Path, capsys):
    good = encode(Frame(3, 0, bytes(4)))
    bad_header = good[:1] + bytes([good[1] ^ 1]) + good[2:]
    bad_frame = good[:-1] + bytes([good[-1] ^ 1])
    path = tmp_path / "bus.pcap"
    whole = b"".join(packet(Captured(0, one)) for one in (good, bad_header, bad_frame, good[:4]))
    path.write_bytes(file_header(210) + whole + timed(9, b"\x01\x00" + good[:8])[:-3])
    answer = concord(capsys, "flexray", "decode", path, "--json").json()
    checks = [(row["header_crc_ok"], row["frame_crc_ok"]) for row in answer["frames"]]
    # A wrong header is a wrong frame, too.
    assert checks == [(True, True), (False, False), (True, False)]
    assert answer["skipped"] == {
        "packet cut at the end of the file": 1,
        "packets that are no frame": 1,
    }


@pytest.fixture(scope="module")
def logged(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("log") / "bus.pcap"
    write_pcap(path, bus_of_a_car(130))
    return path


def test_a_log_gives_the_slots_that_its_waveform_gives(logged: Path):
    from concord.features.flexray_tools.recordings.decoder import decode_waveform

    sent = bus_of_a_car(12)
    decoding = decode_waveform(transmitted(sent, CAR))
    log = logged.with_name("short.pcap")
    write_pcap(log, sent)
    found = fit_log(FrameLog(log))
    by_waveform = fit(decoding)
    assert log_slots(found.tally, found.fit.static_slots) == recorded_slots(decoding, by_waveform)
    assert found.fit.macrotick == by_waveform.macrotick
    assert found.fit.multiplexing == by_waveform.multiplexing
    assert found.fit.dynamic_pairs_explained == found.fit.dynamic_pairs > 0


def test_the_car_as_frames_has_the_slot_table_of_its_waveform(audi: Decoding, tmp_path: Path):
    path = tmp_path / "car.pcap"
    write_pcap(path, (Captured(one.start_us, one.data) for one in audi.frames))
    found = fit_log(FrameLog(path))
    by_waveform = fit(audi)
    assert log_slots(found.tally, found.fit.static_slots) == recorded_slots(audi, by_waveform)
    assert found.fit.static_slots == 51 and found.fit.sync_ids == (8, 24, 45)
    assert found.fit.static_slot_us == pytest.approx(52.2, abs=0.01)
    assert found.fit.minislot_us == pytest.approx(9.0, abs=0.01)


def test_long_logs_prove_multiplexing_and_count_what_is_lost(logged: Path, tmp_path: Path):
    lost = frozenset({(20, 4), (21, 4), (64, 10)}) | {(40, slot) for slot in SLOTS}
    path = tmp_path / "lost.pcap"
    kept = [one for one in bus_of_a_car(130, lost) if not 40 <= one.time_us / CAR.cycle_us < 41]
    write_pcap(path, kept)
    tally = fit_log(FrameLog(path)).tally
    rows = {row.frame_id: row for row in tally.rows}
    assert tally.lost_cycles == 1 and int(tally.recorded.sum()) == 129
    assert (rows[4].lost, rows[10].lost, rows[5].lost) == (2, 1, 0)
    assert rows[7].null == 65 and rows[7].frames == 129
    assert tally.cycle_us == pytest.approx(CAR.cycle_us)
    assert rows[5].jitter_us == pytest.approx((0, 0), abs=1e-3)
    found = {one.frame_id: one for one in fit_log(FrameLog(logged)).fit.multiplexing}
    assert (found[54].base_cycle, found[54].repetition) == (0, 4)
    assert (found[7].base_cycle, found[7].repetition) == (0, 2)


def test_counts_do_not_depend_on_what_is_read_at_a_time(logged: Path, monkeypatch):
    whole = fit_log(FrameLog(logged))
    monkeypatch.setattr(captures, "_READ_BYTES", 500)
    log = FrameLog(logged)
    cut = tallied(log.blocks(), first_frames(log, 20_000))
    for one, other in zip(whole.tally.rows, cut.rows, strict=True):
        np.testing.assert_array_equal(one.seen, other.seen)
        assert one._replace(seen=0, data=0) == other._replace(seen=0, data=0)  # type: ignore[arg-type]
    assert whole.tally.lost_cycles == cut.lost_cycles == 0


def test_times_of_ends_and_dates_are_understood(logged: Path, tmp_path: Path, capsys):
    path = tmp_path / "ends.pcap"
    # The 12 bits are those of the start sequence, FSS and FES at 10 Mbit/s.
    ends = [
        one._replace(time_us=one.time_us + 1.7e15 + 1.2 + len(one.data)) for one in bus_of_a_car(30)
    ]
    write_pcap(path, ends)
    assert "--stamps end" in concord(capsys, "flexray", "fit", path).out
    at_ends = fit_log(FrameLog(path), stamps="end").fit
    assert at_ends.dynamic_pairs == at_ends.dynamic_pairs_explained > 0
    first = concord(capsys, "flexray", "decode", path).out.splitlines()[1]
    assert first.split()[0] == "0.000"


@pytest.mark.skipif(not CASE.is_file(), reason="no ../shared/cases/network to read")
def test_the_case_of_a_table_of_frames(capsys):
    rows = concord(capsys, "flexray", "decode", CASE, "--json").json()["frames"]
    assert [(row["frame_id"], row["cycle"], row["payload"]) for row in rows] == [
        (3, 0, "00112233"),
        (5, 0, "44556677"),
        (3, 1, "00112234"),
    ]
    assert rows[0]["time_us"] == pytest.approx(160)
    assert concord(capsys, "flexray", "fit", CASE, "--json").json()["static_slots"] == 5
    assert concord(capsys, "flexray", "statistics", CASE).code == 0


def test_a_columns_file_names_what_another_tool_wrote(tmp_path: Path, capsys):
    table, columns = tmp_path / "frames.csv", tmp_path / "columns.toml"
    table.write_text(
        "; a comment\nTime;Slot;Cyc;Data;Null\n1.5;0x10;3;0xAB CD;1\n6.5;16;4;abce;0\n"
    )
    columns.write_text(
        'time = { column = "Time", unit = "ms" }\nframe_id = "Slot"\ncycle = "Cyc"\n'
        'payload = "Data"\nnull = "Null"\n'
    )
    said = concord(capsys, "flexray", "decode", table, "--columns", columns, "--json")
    rows = said.json()["frames"]
    assert [row["time_us"] for row in rows] == [1500.0, 6500.0]
    assert [row["frame_id"] for row in rows] == [16, 16]
    assert [row["null"] for row in rows] == [True, False]
    columns.write_text('frame_id = "ID"\n')
    assert "'ID'" in refused(concord(capsys, "flexray", "decode", table, "--columns", columns))
    columns.write_text("id = 3\n")
    assert "columns file" in refused(concord(capsys, "flexray", "fit", table, "--columns", columns))


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("1,3,x,00", "cycle is 'x'"),
        ("1,3,64,00", "cycle is 64"),
        ("later,3,1,00", "the time is 'later'"),
        ("1,3,1,0g", "'0g' is not hexadecimal"),
        ("1,3,1", "line 3"),
    ],
)
def test_a_wrong_line_of_a_table_is_named(line: str, named: str, tmp_path: Path, capsys):
    path = tmp_path / "frames.csv"
    path.write_text(f"time_ms,frame_id,cycle,payload\n1,3,1,00\n{line}\n")
    text = refused(concord(capsys, "flexray", "decode", path))
    assert "line 3" in text and named in text


def test_a_table_and_its_capture_say_the_same(tmp_path: Path, capsys):
    table, capture = tmp_path / "frames.csv", tmp_path / "frames.pcap"
    table.write_text(
        "time_us,channel,frame_id,cycle,payload,sync\n10.5,A,1,0,0011,1\n70,B,2,0,0022,0\n"
    )
    assert concord(capsys, "flexray", "decode", table, "--pcap", capture).code == 0
    said = [
        concord(capsys, "flexray", "decode", one, "--json").json()["frames"]
        for one in (table, capture)
    ]
    assert said[0] == said[1]


def test_logs_of_other_formats_name_a_converter(tmp_path: Path, capsys):
    for name, cure in (("a.mf4", "asammdf"), ("a.asc", "a.blf")):
        path = tmp_path / name
        path.write_bytes(b"MDF     4.10")
        assert cure in refused(concord(capsys, "flexray", "decode", path))
    path = tmp_path / "eth.pcap"
    path.write_bytes(file_header(1) + timed(0, bytes(60)))
    assert "1 packets of link type 1" in refused(concord(capsys, "flexray", "decode", path))


def test_frames_of_a_blf_file(tmp_path: Path):
    pytest.importorskip("vblf")
    path = tmp_path / "bus.blf"
    path.write_bytes(blf([(1000, 1, 8, 3, 4 | 8, b"abcd"), (9000, 3, 9, 3, 1, bytes(4))]))
    (block,) = FrameLog(path).blocks()
    assert [(row[0], channel_name(row[1]), frame_of(*row[2:])) for row in block.rows()] == [
        (1000, "A", Frame(8, 3, b"abcd", sync=True, startup=True)),
        (9000, "A", Frame(9, 3, bytes(4), null=True)),
        (9000, "B", Frame(9, 3, bytes(4), null=True)),
    ]
    path.write_bytes(b"LOGG" + bytes(9))
    with pytest.raises(ValueError, match="no BLF file"):
        list(FrameLog(path).blocks())


def blf(sent: list[tuple[int, int, int, int, int, bytes]]) -> bytes:
    """Write (time in ns, channel mask, ID, cycle, flags, payload) as FR_RCVMESSAGE_EX objects."""
    objects = b""
    for time_ns, mask, frame_id, cycle, flags, payload in sent:
        body = struct.pack(
            "<HHHHIIHHHHHHIIIIIIHHH26s",
            0, 1, mask, 0, 0, 0, frame_id, 0, 0, len(payload), len(payload), cycle, 0, 0, flags, 0,
            0, 0, 0, 0, 0, b"",
        )  # fmt: skip
        size = 32 + len(body) + len(payload)
        objects += struct.pack("<4sHHIIIHHQ", b"LOBJ", 32, 1, size, 66, 2, 0, 0, time_ns)
        objects += body + payload + bytes(size % 4)
    head = struct.pack("<4sI", b"LOGG", 144) + bytes(136)
    return head + objects


def test_a_network_fits_between_the_frames_of_a_bus(logged: Path, tmp_path: Path, capsys):
    seen = fit_log(FrameLog(logged)).tally
    found = network_in_spare_slots(seen, CAR, 4, 24)
    assert found.free_slots == tuple(range(3, 52, 3)) and found.repetition == 1
    table = slots_from_toml(slots_to_toml(found.slots), CAR)
    schedule = written_schedule(table, CAR, 4)
    assert all(schedule.static_senders(cycle) == (0, 1, 2, 3) for cycle in range(4))
    # 17 slots hold 68 nodes that take turns of four.
    assert network_in_spare_slots(seen, CAR, 68, 24).repetition == 4
    with pytest.raises(ValueError, match="hold 1088 nodes"):
        network_in_spare_slots(seen, CAR, 2000, 24)
    out = tmp_path / "slots.toml"
    said = concord(
        capsys, "flexray", "spare", logged, "--cluster", "audi", "--nodes", 4, "--out", out
    )
    assert "17 of 51 static slots have no frame" in said.out and out.is_file()


def test_response_times_of_the_frames_of_a_log(logged: Path, capsys):
    said = concord(
        capsys, "flexray", "wcrt", logged, "--cluster", "audi", "--simulate", 300, "--json"
    )
    frames = said.json()["frames"]
    assert {row["frame_id"] for row in frames} == {*SLOTS, 53, 54, 55}
    assert all(row["seen_us"] <= row["worst_us"] for row in frames)


@pytest.mark.parametrize("bus", ["flexray", "can-fd"])
def test_a_capture_of_a_run_comes_back_whole(bus: str, tmp_path: Path, capsys):
    said = concord(
        capsys, "run", "--scenario", "oscillator", "--nodes", 4, "--steps", 6, "--bus", bus,
        "--out", tmp_path / "run",
    )  # fmt: skip
    assert said.code == 0, said.err
    capture = tmp_path / "run" / "bus.pcap"
    answer = concord(capsys, "flexray", "decode", capture, "--json").json()
    assert answer["frame_count"] == len(answer["frames"]) > 0
    again = tmp_path / "again.pcap"
    if bus == "can-fd":
        assert answer["bus"] == "can"
        assert "CAN" in refused(concord(capsys, "flexray", "fit", capture))
        assert concord(capsys, "flexray", "statistics", capture).code == 0
        return
    assert concord(capsys, "flexray", "decode", capture, "--pcap", again).code == 0
    assert again.read_bytes() == capture.read_bytes()


def test_volts_are_levels_by_a_threshold(tmp_path: Path):
    digital = transmitted(bus_of_a_car(1)[:4], CAR)
    times = np.arange(digital.times_ns[0], digital.times_ns[-1] + 3000, 20)
    levels = digital.levels[np.searchsorted(digital.times_ns, times, side="right") - 1]
    noise = np.random.default_rng(1).normal(0, 0.1, len(times))
    volts = 2.0 + 0.6 * levels + noise
    path = tmp_path / "analogue.csv"
    path.write_text("; Samplerate: 50 MHz\n" + "\n".join(f"{one:.3f}" for one in volts))
    from concord.features.flexray_tools.recordings.decoder import decode_waveform

    decoding = decode_waveform(read_recording(path, threshold=2.3).signal())
    assert [one.frame.frame_id for one in decoding.frames] == [1, 2, 4, 5]
    timed_file = tmp_path / "timed.csv"
    rows = "\n".join(f"{t / 1e3},{v:.3f}" for t, v in zip(times.tolist(), volts, strict=True))
    timed_file.write_text("time_us,volts\n" + rows)
    decoding = decode_waveform(read_recording(timed_file, threshold=2.3).signal())
    assert len(decoding.frames) == 4
    with pytest.raises(ValueError, match="--threshold 2"):
        parse_csv(timed_file.read_text())
    path.write_text("2.0\n2.6\n")
    with pytest.raises(ValueError, match="Samplerate"):
        read_recording(path, threshold=2.3)


def test_a_name_decides_nothing_where_the_content_is_of_a_signal(tmp_path: Path):
    path = tmp_path / "levels.csv"
    path.write_text("time_ns,level\n0,1\n100,0\n")
    assert not log_files.is_frame_log(path)
    assert not log_files.is_frame_log(tmp_path / "absent.csv")
