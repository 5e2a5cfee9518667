"""`concord flexray decode` and `fit`: a real car's bus, a made one, and files that are neither."""

from pathlib import Path

import pytest

from concord.bus.flexray.frame import Frame, encode
from concord.bus.flexray.levels import broken_rules
from concord.bus.flexray.presets import PRESETS
from concord.features.flexray_tools.commands.clusters import read_cluster
from concord.features.flexray_tools.recordings.waveform import Waveform
from tests.experiments.command_support import concord, refused
from tests.features.flexray_tools.signals import encode_bits, format_waveform, from_bits

BIT_NS, SLOT_NS = 100.0, 60_000.0
MADE = [
    Frame(1, 5, bytes(8), sync=True, startup=True),
    Frame(2, 5, b"\x01\x02\x03\x04"),
    Frame(4, 5, bytes(6), null=True),
]


def waveform(frames: list[Frame], damaged: frozenset[int] = frozenset()) -> Waveform:
    """Frames in slots of 60 us after an idle bus; those at `damaged` places have a wrong byte."""
    transmissions = []
    for place, frame in enumerate(frames):
        data = encode(frame)
        if place in damaged:
            data = data[:5] + bytes((data[5] ^ 0x10,)) + data[6:]
        transmissions.append((10_000.0 + SLOT_NS * place, encode_bits(data, 9)))
    return from_bits(transmissions, BIT_NS)


@pytest.fixture
def made(tmp_path: Path) -> Path:
    path = tmp_path / "made.csv"
    path.write_text(format_waveform(waveform(MADE)))
    return path


@pytest.fixture(scope="session")
def car(shared_data: Path) -> Path:
    path = shared_data / "flexray_capture" / "audi_cycles_28_35.csv"
    if not path.exists():
        pytest.skip("needs ../shared/data/flexray_capture")
    return path


# The figures of the car are those of specification page `flexray.md`, counted by others.


def test_the_cluster_of_the_car_is_told(car: Path, capsys):
    text = concord(capsys, "flexray", "fit", car).out
    assert "0 modulo 2 (4 of 8 cycles)" in text and "1 of 8 cycles" in text
    assert "52.20 us" in text and "right for 34 of 34" in text and "8, 24, 45" in text


def test_a_made_recording_gives_back_its_frames(made: Path, capsys):
    answer = concord(capsys, "flexray", "decode", made, "--json").json()
    rows = answer["frames"]
    assert [(row["frame_id"], row["cycle"]) for row in rows] == [(1, 5), (2, 5), (4, 5)]
    assert [bytes.fromhex(row["payload"]) for row in rows] == [f.payload for f in MADE]
    assert [row["sync"] for row in rows] == [True, False, False]
    assert [row["null"] for row in rows] == [False, False, True]
    assert rows[1]["start_us"] - rows[0]["start_us"] == pytest.approx(60.0)
    assert answer["reencoded"] == 3 and answer["unreadable_lines"] == 0


def test_an_inverted_recording_is_decoded_and_said_to_be(tmp_path: Path, capsys):
    path = tmp_path / "inverted.csv"
    path.write_text(format_waveform(waveform(MADE).inverted()))
    answer = concord(capsys, "flexray", "decode", path, "--json").json()
    assert answer["inverted"] and answer["frame_count"] == 3
    assert "inverted" in concord(capsys, "flexray", "decode", path).out


def test_a_wrong_byte_is_a_wrong_checksum_and_a_cut_file_a_rejection(tmp_path: Path, capsys):
    text = format_waveform(waveform(MADE, damaged=frozenset({1})))
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(text.splitlines()[:-20]) + "\n12,")
    answer = concord(capsys, "flexray", "decode", path, "--json").json()
    assert [row["frame_crc_ok"] for row in answer["frames"]] == [True, False]
    assert answer["header_crc_ok"] == 2
    assert answer["frame_crc_ok"] == answer["reencoded"] == 1
    assert answer["rejected"] == {"truncated": 1} and answer["unreadable_lines"] == 1
    text = concord(capsys, "flexray", "decode", path).out
    assert "frame CRC: 1 correct, 1 wrong" in text and "1 truncated" in text


@pytest.mark.parametrize("command", ["decode", "fit"])
def test_what_is_no_recording_is_refused_in_one_sentence(command: str, tmp_path: Path, capsys):
    prose = tmp_path / "prose.csv"
    prose.write_text("not a waveform\nat all\n")
    square = tmp_path / "square.csv"
    square.write_text("time_ns,level\n" + "".join(f"{700 * k},{k % 2}\n" for k in range(200)))
    empty = tmp_path / "empty.csv"
    empty.write_text("")
    for path, says in (
        (tmp_path / "missing.csv", "No such file"),
        (tmp_path, "directory"),
        (prose, "time_ns,level"),
        (square, "no FlexRay frame"),
        (empty, "empty.csv"),
    ):
        sentence = refused(concord(capsys, "flexray", command, path))
        assert says in sentence and str(path) in sentence


def test_a_recording_becomes_a_cluster_and_a_capture(tmp_path: Path, capsys):
    """A made cluster of 2 ms comes back from its own signal, as a file that other commands take."""
    cycle_us, slot_us = 2000.0, 60.0
    sent = []
    for cycle in range(10):
        start_us = 10 + cycle * cycle_us
        for slot in (1, 2, 5):
            key = slot < 3
            frame = Frame(slot, cycle, bytes(8), sync=key, startup=key)
            sent.append((start_us + (slot - 1) * slot_us + 2, encode_bits(encode(frame), 9)))
        # Minislots of 8 us, begun at the end of the static segment; frames of 17.2 + 2 us last 4.
        for frame_id, minislot in ((7, 1), (9, 6), (10, 10)):
            bits = encode_bits(encode(Frame(frame_id, cycle, bytes(8))), 9, 67)
            sent.append((start_us + 5 * slot_us + 8 * minislot + 2, bits))
    path = tmp_path / "made.csv"
    path.write_text(format_waveform(from_bits([(1e3 * t, bits) for t, bits in sent], BIT_NS)))
    cluster, capture = tmp_path / "made.toml", tmp_path / "made.pcap"
    said = concord(capsys, "flexray", "fit", path, "--out", cluster)
    assert str(cluster) in said.out
    answer = concord(capsys, "flexray", "validate", cluster, "--json").json()["cluster"]
    assert (answer["cycle_us"], answer["static_slots"]) == (cycle_us, 5)
    assert answer["static_slot_macroticks"] * answer["macrotick_us"] == pytest.approx(slot_us)
    assert answer["minislot_macroticks"] * answer["macrotick_us"] == pytest.approx(8.0)
    assert answer["sync_slots"] == answer["startup_slots"] == [1, 2]
    text = cluster.read_text()
    assert "minislots = " in text and "gNumberOfMinislots, chosen" in text
    assert "static_slots = 5  # gNumberOfStaticSlots\n" in text
    assert "exists" in refused(concord(capsys, "flexray", "fit", path, "--out", cluster))
    frames = concord(capsys, "flexray", "decode", path, "--pcap", capture, "--json").json()[
        "frames"
    ]
    assert len(frames) == 60
    record = 16 + 2 + 5 + 8
    assert capture.stat().st_size == 24 + 60 * record


def test_the_car_gives_a_cluster_once_its_cycle_is_stated(car: Path, tmp_path: Path, capsys):
    """Its idle times between cycles are known not to be true."""
    target = tmp_path / "car.toml"
    fit = ("flexray", "fit", car, "--out", target)
    sentence = refused(concord(capsys, *fit))
    assert "3843.7 to 4698.7 us" in sentence and "--cycle-us" in sentence
    assert concord(capsys, *fit, "--cycle-us", 5000).code == 0
    made, preset = read_cluster(str(target)), PRESETS["audi"]
    for field in (
        "macroticks_per_cycle",
        "macrotick_us",
        "static_slots",
        "static_slot_macroticks",
        "static_payload_words",
        "minislot_macroticks",
        "action_point_macroticks",
        "transmission_start_bits",
    ):
        assert getattr(made, field) == getattr(preset, field)
    assert made.sync_slots == (8, 24, 45)
    assert not any(broken_rules(made).values())


def test_units_columns_and_rates_are_options(tmp_path: Path, capsys):
    signal = waveform(MADE)
    seconds = tmp_path / "saleae.csv"
    rows = zip(signal.times_ns.tolist(), signal.levels.tolist(), strict=True)
    lines = [f"{time / 1e9:.9f}, {level}, {1 - level}" for time, level in rows]
    seconds.write_text("Time [s], Channel 0, Channel 1\n" + "\n".join(lines))
    decode = ("flexray", "decode", seconds, "--json")
    assert "'Channel 0', 'Channel 1'" in refused(concord(capsys, *decode))
    first = concord(capsys, *decode, "--column", "Channel 0").json()
    second = concord(capsys, *decode, "--column", "Channel 1", "--bit-rate", 10).json()
    assert first["frame_count"] == second["frame_count"] == 3
    assert second["inverted"] and not first["inverted"]
    assert "10, 5 and 2.5" in refused(concord(capsys, *decode, "--bit-rate", 8))
    slow = refused(concord(capsys, *decode, "--column", "Channel 0", "--bit-rate", 5))
    assert "at 5 Mbit/s" in slow
    packed = tmp_path / "session.sr"
    packed.write_bytes(b"PK\x03\x04")
    assert "export" in refused(concord(capsys, "flexray", "decode", packed))
