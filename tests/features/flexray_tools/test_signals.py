"""Signals in logs of frames: bits, codings and descriptions, against packers written by hand."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.presets import preset
from concord.features.flexray_tools.commands.decoded_signals import read_described_signals
from concord.features.flexray_tools.files.arxml import cluster_to_arxml
from concord.features.flexray_tools.files.fibex import cluster_to_fibex
from concord.features.flexray_tools.files.xml_document import ClusterFileError
from concord.features.flexray_tools.frame_logs.log_files import FrameLog
from concord.features.flexray_tools.signals.coding import Coding, DescribedSignals, PlacedSignal
from concord.features.flexray_tools.signals.signal_log import (
    SignalLog,
    signals_of_log,
    write_signals,
)
from concord.plants.recorded.log_files import open_log
from tests.experiments.command_support import concord, refused

PAYLOAD = 16
CLUSTER = preset("audi")


class Drawn(NamedTuple):
    """A signal as a document says it: numbers are (numerator 0, numerator 1) / denominator."""

    name: str
    start: int
    bits: int
    big: bool
    kind: str = "unsigned"
    numerators: tuple[float, float] = (0.0, 1.0)
    denominator: float = 1.0
    invalid: int | None = None
    update: int | None = None


def read_bits(payload: bytes, one: Drawn) -> int:
    """Go from bit to bit as the standards draw it."""
    if not one.big:
        return int.from_bytes(payload, "little") >> one.start & ((1 << one.bits) - 1)
    place, value = one.start, 0
    for _ in range(one.bits):
        value = value << 1 | payload[place // 8] >> place % 8 & 1
        place = place - 1 if place % 8 else place + 15
    return value


def meaning(payload: bytes, one: Drawn) -> float:
    raw = read_bits(payload, one)
    number: float = raw
    if one.kind == "signed" and raw >= 1 << (one.bits - 1):
        number = raw - (1 << one.bits)
    if one.kind == "float":
        number = struct.unpack(">f", raw.to_bytes(4, "big"))[0]
    if one.update is not None and not payload[one.update // 8] >> one.update % 8 & 1:
        return np.nan
    if one.invalid is not None and number == one.invalid:
        return np.nan
    offset, factor = one.numerators
    return factor / one.denominator * number + offset / one.denominator


@given(data=st.data(), payload=st.binary(min_size=PAYLOAD, max_size=PAYLOAD), big=st.booleans())
def test_bits_are_those_of_the_standards_drawing(data: st.DataObject, payload: bytes, big: bool):
    bits = data.draw(st.integers(1, 64))
    if big:
        # From the most significant bit on there must be room, in the order of transmission.
        start = data.draw(st.integers(0, 8 * PAYLOAD - bits)) ^ 7
    else:
        start = data.draw(st.integers(0, 8 * PAYLOAD - bits))
    kind = data.draw(st.sampled_from(("unsigned", "signed")))
    drawn = Drawn("x", start, bits, big, kind)
    signal = PlacedSignal("x", start, big, Coding(bits, kind))
    payloads = np.frombuffer(payload, np.uint8)[None]
    assert int(signal.raw(payloads)[0]) == read_bits(payload, drawn)
    assert signal.values(payloads)[0] == float(meaning(payload, drawn))
    assert signal.payload_bytes <= PAYLOAD
    short = payloads[:, : signal.payload_bytes]
    assert signal.raw(short)[0] == signal.raw(payloads)[0]


SIGNALS = {
    3: [
        Drawn("speed", 8, 16, False, numerators=(-5.0, 2.0), denominator=4.0, invalid=65535),
        Drawn("torque", 39, 12, True, "signed"),
        Drawn("counter", 0, 4, False),
    ],
    5: [
        Drawn("level", 7, 32, True, "float", numerators=(1.5, 1.0)),
        Drawn("counter", 40, 8, False, update=63),
    ],
}
SLOTS = [
    MessageSlot(frame_id=3, payload_bytes=PAYLOAD, base_cycle=1, repetition=2),
    MessageSlot(frame_id=5, payload_bytes=PAYLOAD, channel="AB"),
]


def frame_ids(slots: Sequence[MessageSlot]) -> dict[int, str]:
    return {
        one.frame_id: f"frame_{one.frame_id}_{one.base_cycle}_{one.repetition}_{one.channel}"
        for one in slots
    }


def fibex(before: int = 0) -> str:
    """A document whose PDUs begin so many bytes after the payload."""
    text = cluster_to_fibex(CLUSTER, SLOTS)
    pdus, signals, codings = "", "", ""
    for frame_id, drawn in SIGNALS.items():
        name = frame_ids(SLOTS)[frame_id]
        at = text.index("</fx:FRAME>", text.index(f'<fx:FRAME ID="{name}"'))
        instance = (
            f'<fx:PDU-INSTANCES><fx:PDU-INSTANCE><fx:PDU-REF ID-REF="pdu{frame_id}"/>'
            f"<fx:BIT-POSITION>{8 * before}</fx:BIT-POSITION></fx:PDU-INSTANCE></fx:PDU-INSTANCES>"
        )
        text = text[:at] + instance + text[at:]
        placed = ""
        for one in drawn:
            key = f"{one.name}{frame_id}"
            update = (
                ""
                if one.update is None
                else f"<fx:SIGNAL-UPDATE-BIT-POSITION>{one.update - 8 * before}"
                "</fx:SIGNAL-UPDATE-BIT-POSITION>"
            )
            placed += (
                f"<fx:SIGNAL-INSTANCE><fx:BIT-POSITION>{one.start - 8 * before}</fx:BIT-POSITION>"
                f"<fx:IS-HIGH-LOW-BYTE-ORDER>{str(one.big).lower()}</fx:IS-HIGH-LOW-BYTE-ORDER>"
                f'{update}<fx:SIGNAL-REF ID-REF="{key}"/></fx:SIGNAL-INSTANCE>'
            )
            signals += (
                f'<fx:SIGNAL ID="{key}"><ho:SHORT-NAME>{one.name}</ho:SHORT-NAME>'
                f'<fx:CODING-REF ID-REF="c{key}"/></fx:SIGNAL>'
            )
            base = {"unsigned": "A_UINT32", "signed": "A_INT32", "float": "A_FLOAT32"}[one.kind]
            invalid = (
                ""
                if one.invalid is None
                else '<ho:INTERNAL-CONSTRS><ho:SCALE-CONSTR VALIDITY="NOT-VALID"><ho:LOWER-LIMIT>'
                f"{one.invalid}</ho:LOWER-LIMIT><ho:UPPER-LIMIT>{one.invalid}</ho:UPPER-LIMIT>"
                "</ho:SCALE-CONSTR></ho:INTERNAL-CONSTRS>"
            )
            low, high = one.numerators
            codings += (
                f'<fx:CODING ID="c{key}"><ho:CODED-TYPE ho:BASE-DATA-TYPE="{base}">'
                f"<ho:BIT-LENGTH>{one.bits}</ho:BIT-LENGTH></ho:CODED-TYPE><ho:COMPU-METHODS>"
                f"<ho:COMPU-METHOD><ho:CATEGORY>LINEAR</ho:CATEGORY>{invalid}"
                "<ho:COMPU-INTERNAL-TO-PHYS><ho:COMPU-SCALES><ho:COMPU-SCALE>"
                f"<ho:COMPU-RATIONAL-COEFFS><ho:COMPU-NUMERATOR><ho:V>{low}</ho:V><ho:V>{high}"
                f"</ho:V></ho:COMPU-NUMERATOR><ho:COMPU-DENOMINATOR><ho:V>{one.denominator}</ho:V>"
                "</ho:COMPU-DENOMINATOR></ho:COMPU-RATIONAL-COEFFS></ho:COMPU-SCALE>"
                "</ho:COMPU-SCALES></ho:COMPU-INTERNAL-TO-PHYS></ho:COMPU-METHOD>"
                "</ho:COMPU-METHODS></fx:CODING>"
            )
        pdus += (
            f'<fx:PDU ID="pdu{frame_id}"><fx:SIGNAL-INSTANCES>{placed}</fx:SIGNAL-INSTANCES>'
            "</fx:PDU>"
        )
    return text.replace(
        "</fx:ELEMENTS>",
        f"<fx:PDUS>{pdus}</fx:PDUS><fx:SIGNALS>{signals}</fx:SIGNALS></fx:ELEMENTS>"
        f"<fx:PROCESSING-INFORMATION><fx:CODINGS>{codings}</fx:CODINGS>"
        "</fx:PROCESSING-INFORMATION>",
    )


def arxml(before: int = 0) -> str:
    """The same as AUTOSAR."""
    text = cluster_to_arxml(CLUSTER, SLOTS)
    elements = (
        "<SW-BASE-TYPE><SHORT-NAME>signed</SHORT-NAME><BASE-TYPE-ENCODING>2C</BASE-TYPE-ENCODING>"
        "</SW-BASE-TYPE><SW-BASE-TYPE><SHORT-NAME>float</SHORT-NAME><BASE-TYPE-ENCODING>IEEE754"
        "</BASE-TYPE-ENCODING></SW-BASE-TYPE><SW-BASE-TYPE><SHORT-NAME>unsigned</SHORT-NAME>"
        "<BASE-TYPE-ENCODING>NONE</BASE-TYPE-ENCODING></SW-BASE-TYPE>"
    )
    order = {True: "MOST-SIGNIFICANT-BYTE-FIRST", False: "MOST-SIGNIFICANT-BYTE-LAST"}
    for frame_id, drawn in SIGNALS.items():
        name = frame_ids(SLOTS)[frame_id]
        end = f"<SHORT-NAME>{name}</SHORT-NAME><FRAME-LENGTH>{PAYLOAD}</FRAME-LENGTH>"
        assert text.count(end) == 1
        mapping = (
            "<PDU-TO-FRAME-MAPPINGS><PDU-TO-FRAME-MAPPING><SHORT-NAME>m</SHORT-NAME>"
            f"<PACKING-BYTE-ORDER>{order[False]}</PACKING-BYTE-ORDER>"
            f'<PDU-REF DEST="I-SIGNAL-I-PDU">/signals/pdu{frame_id}</PDU-REF>'
            f"<START-POSITION>{8 * before}</START-POSITION></PDU-TO-FRAME-MAPPING>"
            "</PDU-TO-FRAME-MAPPINGS>"
        )
        text = text.replace(end, end + mapping)
        placed = ""
        for one in drawn:
            # An element has one name for its path, so names that are there twice get a package.
            key = f"{one.name}{frame_id}"
            update = (
                ""
                if one.update is None
                else f"<UPDATE-INDICATION-BIT-POSITION>{one.update - 8 * before}"
                "</UPDATE-INDICATION-BIT-POSITION>"
            )
            placed += (
                f"<I-SIGNAL-TO-I-PDU-MAPPING><SHORT-NAME>{key}</SHORT-NAME>"
                f'<I-SIGNAL-REF DEST="I-SIGNAL">/signals/f{frame_id}/{one.name}</I-SIGNAL-REF>'
                f"<PACKING-BYTE-ORDER>{order[one.big]}</PACKING-BYTE-ORDER>"
                f"<START-POSITION>{one.start - 8 * before}</START-POSITION>{update}"
                "</I-SIGNAL-TO-I-PDU-MAPPING>"
            )
            low, high = one.numerators
            elements += (
                f"<COMPU-METHOD><SHORT-NAME>c{key}</SHORT-NAME><CATEGORY>LINEAR</CATEGORY>"
                "<COMPU-INTERNAL-TO-PHYS><COMPU-SCALES><COMPU-SCALE><COMPU-RATIONAL-COEFFS>"
                f"<COMPU-NUMERATOR><V>{low}</V><V>{high}</V></COMPU-NUMERATOR><COMPU-DENOMINATOR>"
                f"<V>{one.denominator}</V></COMPU-DENOMINATOR></COMPU-RATIONAL-COEFFS>"
                "</COMPU-SCALE></COMPU-SCALES></COMPU-INTERNAL-TO-PHYS></COMPU-METHOD>"
            )
        elements += (
            f"<I-SIGNAL-I-PDU><SHORT-NAME>pdu{frame_id}</SHORT-NAME><LENGTH>{PAYLOAD - before}"
            f"</LENGTH><I-SIGNAL-TO-PDU-MAPPINGS>{placed}</I-SIGNAL-TO-PDU-MAPPINGS>"
            "</I-SIGNAL-I-PDU>"
        )
    packages = "".join(
        f"<AR-PACKAGE><SHORT-NAME>f{frame_id}</SHORT-NAME><ELEMENTS>"
        + "".join(_i_signal(frame_id, one) for one in drawn)
        + "</ELEMENTS></AR-PACKAGE>"
        for frame_id, drawn in SIGNALS.items()
    )
    return text.replace(
        "</AR-PACKAGES></AUTOSAR>",
        f"<AR-PACKAGE><SHORT-NAME>signals</SHORT-NAME><ELEMENTS>{elements}</ELEMENTS>"
        f"<AR-PACKAGES>{packages}</AR-PACKAGES></AR-PACKAGE></AR-PACKAGES></AUTOSAR>",
    )


def _i_signal(frame_id: int, one: Drawn) -> str:
    invalid = (
        ""
        if one.invalid is None
        else f"<INVALID-VALUE><NUMERICAL-VALUE-SPECIFICATION><VALUE>{one.invalid}</VALUE>"
        "</NUMERICAL-VALUE-SPECIFICATION></INVALID-VALUE>"
    )
    return (
        f"<I-SIGNAL><SHORT-NAME>{one.name}</SHORT-NAME><LENGTH>{one.bits}</LENGTH>"
        "<NETWORK-REPRESENTATION-PROPS><SW-DATA-DEF-PROPS-VARIANTS><SW-DATA-DEF-PROPS-CONDITIONAL>"
        f'<BASE-TYPE-REF DEST="SW-BASE-TYPE">/signals/{one.kind}</BASE-TYPE-REF>'
        f'<COMPU-METHOD-REF DEST="COMPU-METHOD">/signals/c{one.name}{frame_id}</COMPU-METHOD-REF>'
        f"{invalid}</SW-DATA-DEF-PROPS-CONDITIONAL></SW-DATA-DEF-PROPS-VARIANTS>"
        "</NETWORK-REPRESENTATION-PROPS></I-SIGNAL>"
    )


WRITERS = {"fibex": fibex, "arxml": arxml}


def logged(cycles: int = 40, seed: int = 0) -> tuple[str, dict[int, list[tuple[float, bytes]]]]:
    """A log of both frames, the second on both channels, and what was sent when."""
    generator = np.random.default_rng(seed)
    lines = ["time_s,channel,frame_id,cycle,payload,null"]
    sent: dict[int, list[tuple[float, bytes]]] = {3: [], 5: []}
    for cycle in range(cycles):
        for frame_id in (3, 5):
            at_s = cycle * 0.005 + frame_id * 1e-4
            payload = generator.bytes(PAYLOAD)
            if frame_id == 3 and cycle % 8 == 1:
                payload = payload[:1] + b"\xff\xff" + payload[3:]
            if frame_id == 3 and cycle % 2 == 0:
                # Another frame of this slot.
                payload = bytes(PAYLOAD)
            elif frame_id == 3 and cycle % 10 == 3:
                lines.append(f"{at_s:.6f},A,3,{cycle % 64},{payload.hex()},1")
                continue
            elif frame_id == 3 and cycle % 10 == 5:
                payload = payload[:2]
            else:
                sent[frame_id].append((at_s, payload))
            for letter in "AB"[: 1 if frame_id == 3 else 2]:
                lines.append(f"{at_s:.6f},{letter},{frame_id},{cycle % 64},{payload.hex()},0")
    return "\n".join(lines) + "\n", sent


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "frames.csv"
    path.write_text(logged()[0])
    return path


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize("before", [0, 1])
def test_signals_of_a_description_are_what_was_sent(form: str, before: int, log: Path):
    described = log.with_name("bus.xml")
    # A PDU further on in the frame, with its signals further back in the PDU.
    text = WRITERS[form](before) if before == 0 else WRITERS[form](0)
    if before:
        text = text.replace(*PDU_STARTS[form])
    described.write_text(text)
    found = signals_of_log(FrameLog(log), read_described_signals(described))
    sent = logged()[1]
    assert len(found.series) == 2 and not found.silent
    for series, (frame_id, drawn) in zip(found.series, SIGNALS.items(), strict=True):
        assert series.time_s == pytest.approx([at_s for at_s, _ in sent[frame_id]])
        names = [one.name if one.name != "counter" else None for one in drawn]
        for place, (name, one) in enumerate(zip(names, drawn, strict=True)):
            expected = [
                meaning(payload[before:] + bytes(before), one) for _, payload in sent[frame_id]
            ]
            assert name is None or series.names[place] == name
            np.testing.assert_array_equal(series.values[:, place], expected)
    if not before:
        assert found.invalid["speed"] == sum(p[1:3] == b"\xff\xff" for _, p in sent[3]) > 0
        assert sum(found.stale.values()) == sum(not p[7] >> 7 for _, p in sent[5]) > 0
        assert list(found.short.values()) == [4]


PDU_STARTS = {
    "fibex": ("<fx:BIT-POSITION>0</fx:BIT-POSITION></fx:PDU-INSTANCE>",
              "<fx:BIT-POSITION>8</fx:BIT-POSITION></fx:PDU-INSTANCE>"),
    "arxml": ("<START-POSITION>0</START-POSITION></PDU-TO-FRAME-MAPPING>",
              "<START-POSITION>8</START-POSITION></PDU-TO-FRAME-MAPPING>"),
}  # fmt: skip


def test_the_description_of_the_test_is_one_of_autosar(tmp_path: Path):
    autosar_data = pytest.importorskip("autosar_data", reason="of the development group")
    path = tmp_path / "bus.arxml"
    path.write_text(arxml())
    model = autosar_data.AutosarModel()
    _, warnings = model.load_file(str(path), strict=True)
    assert not warnings and not model.check_references()


def test_three_kinds_of_files_hold_equal_series(log: Path):
    pytest.importorskip("mcap_ros2", reason="of the extra logs")
    described = log.with_name("bus.xml")
    described.write_text(fibex())
    found = signals_of_log(FrameLog(log), read_described_signals(described))
    files = {}
    for ending, named in (("csv", "{}"), ("nc", "{}"), ("mcap", "/{}.data")):
        path = log.with_name(f"drive.{ending}")
        write_signals(path, found)
        files[ending] = open_log(path), named
    for series in found.series:
        for place, name in enumerate(series.names):
            there = ~np.isnan(series.values[:, place])
            for file, named in files.values():
                values = file.series(named.format(name))
                np.testing.assert_array_equal(
                    values[~np.isnan(values)], series.values[there, place]
                )
                stamps_s = file.stamps_s(named.format(name))
                stamps_s = file.series("time") if stamps_s is None else stamps_s
                assert stamps_s[~np.isnan(values)] == pytest.approx(series.time_s[there], abs=1e-9)


def test_what_is_no_number_is_left_out_by_name(log: Path):
    described = log.with_name("bus.xml")
    text = fibex().replace('"A_INT32"', '"A_ASCIISTRING"', 1)
    described.write_text(text)
    found = read_described_signals(described)
    assert found.left_out == {"torque": "it is of type A_ASCIISTRING"}
    assert [one.name for one in found.frames[0].signals] == ["speed", "counter"]
    described.write_text(text.replace("<ho:V>4.0</ho:V>", "<ho:V>many</ho:V>"))
    with pytest.raises(ClusterFileError, match=r"signal 'speed': 'many' must be a number"):
        read_described_signals(described)
    described.write_text(cluster_to_fibex(CLUSTER, SLOTS))
    with pytest.raises(ClusterFileError, match="export it with its signals and PDUs"):
        read_described_signals(described)


def test_the_command_says_what_it_needs_and_found(log: Path, capsys: pytest.CaptureFixture[str]):
    described, out = log.with_name("bus.xml"), log.with_name("drive.csv")
    described.write_text(fibex())
    decode = ("flexray", "decode", log)
    told = concord(capsys, *decode, "--signals", out, "--description", described)
    assert told.code == 0 and "speed" in told.out and f"the series are in {out}" in told.out
    other = log.with_name("other.csv")
    for words, cure in (
        (("--signals", other), "--description FILE.xml"),
        (("--description", described), "--signals FILE"),
        (("--signals", "x.txt", "--description", described), "must end in .csv, .nc or .mcap"),
        (("--signals", out, "--description", described), "exists; name another file"),
        (("--signals", other, "--description", "gone.xml"), "gone.xml: cannot be read"),
    ):
        assert cure in refused(concord(capsys, *decode, *words))
    log.write_text("time_s,channel,frame_id,cycle,payload\n0.1,A,9,0,0011\n")
    said = refused(concord(capsys, *decode, "--signals", other, "--description", described))
    assert "none of the frames with signals came (IDs 3, 5)" in said
    assert not other.exists()


def in_document(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert text.count(old) >= 1, old
        text = text.replace(old, new)
    return text


def part(text: str, first: str, end: str) -> str:
    at = text.index(first)
    return text[at : text.index(end, at)]


def read(log: Path, text: str) -> tuple[DescribedSignals, SignalLog]:
    described = log.with_name("bus.xml")
    described.write_text(text)
    return read_described_signals(described), signals_of_log(
        FrameLog(log), read_described_signals(described)
    )


def test_a_frame_in_several_slots_is_one_series_and_names_are_unique(log: Path):
    three, five = (frame_ids(SLOTS)[one] for one in (3, 5))
    twice = in_document(
        fibex(), (f'<fx:FRAME-REF ID-REF="{three}"/>', f'<fx:FRAME-REF ID-REF="{five}"/>')
    )
    _, found = read(log, twice)
    (series,) = found.series
    assert series.names == ("level", "counter") and (np.diff(series.time_s) >= 0).all()
    # A PDU that is there twice in a frame.
    instance = fibex()[
        (at := fibex().index("<fx:PDU-INSTANCE>")) : fibex().index("</fx:PDU-INSTANCES>", at)
    ]
    _, found = read(log, in_document(fibex(), (instance, instance * 2)))
    names = [name for one in found.series for name in one.names]
    assert len(set(names)) == len(names) == 8
    # Names that no column, variable or topic can have.
    odd = in_document(
        fibex(),
        ("<ho:SHORT-NAME>speed<", "<ho:SHORT-NAME>a,b/c d<"),
        ("<ho:SHORT-NAME>torque<", "<ho:SHORT-NAME>time<"),
    )
    _, found = read(log, odd)
    assert found.series[0].names[:2] == ("a_b_c_d", f"{three}_time")


def test_words_beside_a_line_are_no_numbers_and_open_limits_are_outside(log: Path):
    scale = "<ho:COMPU-SCALE><ho:COMPU-RATIONAL-COEFFS>"
    words = (
        '<ho:COMPU-SCALE><ho:LOWER-LIMIT INTERVAL-TYPE="OPEN">65530</ho:LOWER-LIMIT>'
        "<ho:UPPER-LIMIT>65535</ho:UPPER-LIMIT><ho:COMPU-CONST><ho:VT>SNA</ho:VT></ho:COMPU-CONST>"
        "</ho:COMPU-SCALE>"
    )
    described, _ = read(log, in_document(fibex(), (scale, words + scale)))
    (low, high), *_ = described.frames[0].signals[0].coding.invalid
    assert 65530 < low < 65530.001 and high == 65535
    coding = described.frames[0].signals[0].coding
    payloads = np.array([[*value.to_bytes(2, "little")] for value in (65530, 65531)], np.uint8)
    values = PlacedSignal("x", 0, False, coding).values(payloads)
    assert values[0] == (2 * 65530 - 5) / 4 and np.isnan(values[1])
    # Words alone, and coefficients that no number survives.
    rational = fibex()[
        (at := fibex().index("<ho:COMPU-RATIONAL-COEFFS>")) : fibex().index("</ho:COMPU-SCALE>", at)
    ]
    for change, why in (
        ((rational, "<ho:COMPU-CONST><ho:VT>on</ho:VT></ho:COMPU-CONST>"), "a table of words"),
        (("<ho:V>4.0</ho:V>", "<ho:V>1e-320</ho:V>"), "the factor inf"),
        (('<fx:CODING-REF ID-REF="cspeed3"/>', '<fx:CODING-REF ID-REF="gone"/>'), "no coding"),
    ):
        described, _ = read(log, in_document(fibex(), change))
        assert why in described.left_out["speed"]
    described, _ = read(
        log,
        in_document(fibex(), ('<fx:SIGNAL-REF ID-REF="speed3"/>', '<fx:SIGNAL-REF ID-REF="x"/>')),
    )
    assert described.left_out == {"x": "its <SIGNAL-REF> leads nowhere"}


def test_a_file_that_fails_leaves_nothing_behind(log: Path, monkeypatch: pytest.MonkeyPatch):
    _, found = read(log, fibex())
    early = found._replace(
        series=tuple(one._replace(time_s=one.time_s - 1) for one in found.series)
    )
    with pytest.raises(ValueError, match="no stamps before 0"):
        write_signals(log.with_name("x.mcap"), early)
    with pytest.raises(ValueError, match="there is no folder"):
        write_signals(log.parent / "gone" / "x.nc", found)
    monkeypatch.setattr(Path, "rename", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
    for ending in ("csv", "nc"):
        with pytest.raises(ValueError, match="cannot be written"):
            write_signals(log.with_name(f"x.{ending}"), found)
    assert {one.name for one in log.parent.iterdir()} == {"frames.csv", "bus.xml"}


def test_a_table_of_signals_is_read_again_where_some_have_no_unit(log: Path):
    text = in_document(
        fibex(),
        (
            "<fx:PROCESSING-INFORMATION>",
            '<fx:PROCESSING-INFORMATION><ho:UNIT-SPEC><ho:UNIT ID="u">'
            "<ho:DISPLAY-NAME>m/s</ho:DISPLAY-NAME></ho:UNIT></ho:UNIT-SPEC>",
        ),
    )
    at = text.index("<ho:CATEGORY>LINEAR</ho:CATEGORY>")
    text = text[:at] + '<ho:UNIT-REF ID-REF="u"/>' + text[at:]
    _, found = read(log, text)
    write_signals(path := log.with_name("drive.csv"), found)
    file = open_log(path)
    assert file.unit("speed") == "m/s" and file.unit("torque") is None
    assert np.isfinite(file.series("speed")).any()
