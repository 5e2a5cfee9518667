"""`concord flexray decode` and `fit`: the frames of a recording, and their cluster."""

import sys
from collections import Counter
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from concord.bus.bus import Captured
from concord.bus.flexray.cluster import BIT_RATES_MBPS
from concord.bus.flexray.cluster_files import cluster_to_toml
from concord.bus.flexray.slot_file import slots_to_toml
from concord.bus.pcap import CapturedSymbol, write_pcap
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.features.flexray_tools.commands.clusters import write_new
from concord.features.flexray_tools.commands.decoded_signals import print_signals
from concord.features.flexray_tools.commands.fit_report import fit_lines, multiplex_table
from concord.features.flexray_tools.commands.frame_logs import (
    Columns,
    print_decoded,
    print_fit,
    write_fit,
)
from concord.features.flexray_tools.frame_logs.log_files import FrameLog, Stamps, is_frame_log
from concord.features.flexray_tools.frame_logs.log_fit import fit_log
from concord.features.flexray_tools.recordings.csv_recording import Unit
from concord.features.flexray_tools.recordings.decoder import (
    DecodedFrame,
    Decoding,
    decode_waveform,
    reencodes,
)
from concord.features.flexray_tools.recordings.fit import fit as fit_cluster
from concord.features.flexray_tools.recordings.recorded_cluster import (
    recorded_cluster,
    recorded_slots,
)
from concord.features.flexray_tools.recordings.recording_files import read_recording
from concord.features.flexray_tools.recordings.symbols import Symbol

Waveform = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="WAVEFORM")]
BitRate = Annotated[float | None, tyro.conf.arg(metavar="MBPS")]

_SHOWN_BYTES = 8
_HEADING = (
    f"{'start us':>12} {'cycle':>5} {'ID':>5} {'segment':<7} {'bytes':>5} {'kind':<12} "
    f"{'wrong CRC':<12} payload"
)


class FrameRow(msgspec.Struct, frozen=True):
    """One recorded frame; `payload` in hexadecimal, times in microseconds of the recording."""

    start_us: float
    end_us: float
    cycle: int
    frame_id: int
    segment: str
    null: bool
    sync: bool
    startup: bool
    payload_preamble: bool
    header_crc_ok: bool
    frame_crc_ok: bool
    payload: str


class DecodeFigures(msgspec.Struct, frozen=True):
    """Contents of a recording. `static`, `dynamic` and `null` count frames with a right header CRC.

    `reencoded` frames give back their recorded bits when they are encoded anew; `rejected` counts
    starts of frames that led to none, by reason.
    """

    frame_count: int
    header_crc_ok: int
    frame_crc_ok: int
    static: int
    dynamic: int
    null: int
    reencoded: int
    rejected: dict[str, int]
    glitches: int
    symbols: list[Symbol]
    unreadable_lines: int
    bit_rate_mbps: float
    channel: str
    inverted: bool
    static_slots: int


def decode(
    waveform: Waveform,
    /,
    *,
    bit_rate: BitRate = None,
    column: str | None = None,
    unit: Unit | None = None,
    threshold: float | None = None,
    columns: Columns = None,
    pcap: Path | None = None,
    signals: Path | None = None,
    description: Path | None = None,
    cluster_name: str | None = None,
    json: bool = False,
) -> None:
    """List the frames of a recorded waveform, or of a log of frames, and check every checksum.

    Args:
        waveform: CSV with a line for every change of level (time_ns,level), or VCD. Or a log of
            frames: pcap or pcapng (link type 210 or 227), BLF, or CSV with a line for each frame.
        bit_rate: Bit rate in Mbit/s: 10, 5 or 2.5. Otherwise that of the most correct frames.
        column: Which signal of a file that has several.
        unit: Unit of the times of a CSV file. Otherwise its heading decides.
        threshold: Volts from which on samples of an analogue recording are high.
        columns: Columns file of a CSV log of frames.
        pcap: Capture file to write for Wireshark.
        signals: Series of signals to write from a log of frames: .csv, .nc or .mcap.
        description: FIBEX or AUTOSAR file that says where these signals stand.
        cluster_name: Which cluster of a description that has several.
        json: Print one JSON object.
    """
    with user_errors():
        is_log = is_frame_log(waveform, columns)
        if signals is not None or description is not None:
            log = FrameLog(waveform, columns) if is_log else None
            print_signals(log, signals, description, cluster_name)
            return
        if is_log:
            print_decoded(FrameLog(waveform, columns), pcap, json)
            return
        decoding, unreadable = read_recorded(waveform, bit_rate, column, unit, threshold)
        if pcap is not None:
            _write_capture(pcap, decoding)
    figures, rows = summarise(decoding, unreadable), frame_rows(decoding)
    if json:
        result = {
            **msgspec.structs.asdict(figures),
            "symbols": [symbol._asdict() for symbol in figures.symbols],
            "frames": rows,
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    for line in (_HEADING, *map(_frame_line, rows), *_decode_lines(figures)):
        sys.stdout.write(f"{line}\n")


def fit(
    waveform: Waveform,
    /,
    *,
    bit_rate: BitRate = None,
    column: str | None = None,
    unit: Unit | None = None,
    threshold: float | None = None,
    columns: Columns = None,
    stamps: Stamps = "start",
    static_slots: int | None = None,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    slots: Path | None = None,
    cycle_us: float | None = None,
    json: bool = False,
) -> None:
    """Infer the cluster behind a recording: slots, minislots, multiplexing, sync nodes.

    Args:
        waveform: CSV with a line for every change of level (time_ns,level), or VCD. Or a log of
            frames: pcap or pcapng (link type 210), BLF, or CSV with a line for each frame.
        bit_rate: Bit rate in Mbit/s: 10, 5 or 2.5. Otherwise that of the most correct frames.
        column: Which signal of a file that has several.
        unit: Unit of the times of a CSV file. Otherwise its heading decides.
        threshold: Volts from which on samples of an analogue recording are high.
        columns: Columns file of a CSV log of frames.
        stamps: Whether a log has the times of the starts or the ends of frames.
        static_slots: Static slots of the bus of a log. Otherwise lengths and times tell them.
        out: Cluster file (.toml) to write. It says which parameters were chosen.
        slots: Slot table (.toml) to write, for `concord flexray wcrt`.
        cycle_us: Length of a cycle for the cluster file. Otherwise the recording tells it.
        json: Print one JSON object.
    """
    with user_errors():
        if is_frame_log(waveform, columns):
            found = fit_log(FrameLog(waveform, columns), bit_rate, static_slots, stamps)
            write_fit(found, waveform.stem, out, slots, cycle_us)
            print_fit(found, out, json)
            return
        decoding, _ = read_recorded(waveform, bit_rate, column, unit, threshold)
        fitted = fit_cluster(decoding)
        if out is not None:
            made = recorded_cluster(decoding, fitted, waveform.stem, cycle_us)
            write_new(out, cluster_to_toml(made.cluster, made.chosen))
        if slots is not None:
            write_new(slots, slots_to_toml(recorded_slots(decoding, fitted)))
    if json:
        ticks = fitted.macrotick
        result = {
            **fitted._asdict(),
            "macrotick": None if ticks is None else ticks._asdict(),
            "multiplexing": [entry._asdict() for entry in fitted.multiplexing],
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    for line in fit_lines(fitted):
        sys.stdout.write(f"{line}\n")
    plain_console().print(multiplex_table(fitted.multiplexing))
    if out is not None:
        sys.stdout.write(f"the cluster is in {out}; it marks the parameters that were chosen\n")


def read_recorded(
    path: Path,
    bit_rate_mbps: float | None = None,
    column: str | None = None,
    unit: Unit | None = None,
    threshold: float | None = None,
) -> tuple[Decoding, int]:
    """Return the frames of a waveform file, and how many of its lines said nothing.

    Raises:
        ValueError: the file cannot be read, or holds no FlexRay frame.
    """
    if bit_rate_mbps is not None and bit_rate_mbps not in BIT_RATES_MBPS:
        raise ValueError(f"--bit-rate {bit_rate_mbps:g}: FlexRay has 10, 5 and 2.5 Mbit/s")
    try:
        recording = read_recording(path, unit, threshold)
        return decode_waveform(recording.signal(column), bit_rate_mbps), recording.unreadable
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _write_capture(path: Path, decoding: Decoding) -> None:
    """Write frames and symbols in order, timed from the first of them."""
    events: list[Captured | CapturedSymbol] = [
        Captured(decoded.start_us, decoded.data, decoding.channel) for decoded in decoding.frames
    ]
    for symbol in decoding.symbols:
        low_bits = round((symbol.end_us - symbol.start_us) * decoding.bit_rate_mbps)
        events.append(CapturedSymbol(symbol.start_us, low_bits, decoding.channel))
    events.sort(key=lambda event: event.time_us)
    first_us = events[0].time_us
    try:
        write_pcap(path, (event._replace(time_us=event.time_us - first_us) for event in events))
    except OSError as error:
        raise ValueError(f"{path}: cannot be written ({error.strerror})") from None


def summarise(decoding: Decoding, unreadable_lines: int) -> DecodeFigures:
    """Counts over the frames of a recording."""
    sure = [frame for frame in decoding.frames if frame.header_crc_ok]
    static = sum(decoding.segment(frame) == "static" for frame in sure)
    return DecodeFigures(
        frame_count=len(decoding.frames),
        header_crc_ok=len(sure),
        frame_crc_ok=sum(frame.frame_crc_ok for frame in decoding.frames),
        static=static,
        dynamic=len(sure) - static,
        null=sum(frame.frame.null for frame in sure),
        reencoded=sum(reencodes(frame, decoding.channel) for frame in decoding.frames),
        rejected=decoding.rejected,
        glitches=decoding.glitches,
        symbols=list(decoding.symbols),
        unreadable_lines=unreadable_lines,
        bit_rate_mbps=decoding.bit_rate_mbps,
        channel=decoding.channel,
        inverted=decoding.inverted,
        static_slots=decoding.static_slots,
    )


def frame_rows(decoding: Decoding) -> list[FrameRow]:
    """Return the frames of a recording in order."""
    return [_row(decoding, decoded) for decoded in decoding.frames]


def _row(decoding: Decoding, decoded: DecodedFrame) -> FrameRow:
    frame = decoded.frame
    return FrameRow(
        start_us=decoded.start_us,
        end_us=decoded.end_us,
        cycle=frame.cycle_count,
        frame_id=frame.frame_id,
        segment=decoding.segment(decoded),
        null=frame.null,
        sync=frame.sync,
        startup=frame.startup,
        payload_preamble=frame.payload_preamble,
        header_crc_ok=decoded.header_crc_ok,
        frame_crc_ok=decoded.frame_crc_ok,
        payload=frame.payload.hex(),
    )


def _frame_line(row: FrameRow) -> str:
    marks = {"null": row.null, "sync": row.sync, "startup": row.startup}
    kind = " ".join(name for name, there in marks.items() if there)
    wrong = {"header": not row.header_crc_ok, "frame": not row.frame_crc_ok}
    checks = "+".join(name for name, there in wrong.items() if there)
    cut = "..." if len(row.payload) > 2 * _SHOWN_BYTES else ""
    return (
        f"{row.start_us:12.2f} {row.cycle:5d} {row.frame_id:5d} {row.segment:<7} "
        f"{len(row.payload) // 2:5d} {kind:<12} {checks:<12} "
        f"{row.payload[: 2 * _SHOWN_BYTES]}{cut}"
    )


def _decode_lines(figures: DecodeFigures) -> list[str]:
    count = figures.frame_count
    rejected = ", ".join(f"{n} {reason}" for reason, n in sorted(figures.rejected.items()))
    text = [
        f"{count} frames at {figures.bit_rate_mbps:g} Mbit/s on channel {figures.channel}: "
        f"{figures.static} static (IDs up to {figures.static_slots}), {figures.dynamic} dynamic; "
        f"{figures.null} null frames",
        f"header CRC: {figures.header_crc_ok} correct, {count - figures.header_crc_ok} wrong; "
        f"frame CRC: {figures.frame_crc_ok} correct, {count - figures.frame_crc_ok} wrong",
        f"encoded anew, {figures.reencoded} of {count} frames give back their bits",
        f"rejected: {rejected or 'none'}; low pulses that begin no frame: {figures.glitches}; "
        f"unreadable lines: {figures.unreadable_lines}",
    ]
    named = Counter(symbol.name for symbol in figures.symbols)
    if named:
        text.append("symbols: " + ", ".join(f"{n} {name}" for name, n in sorted(named.items())))
    if figures.inverted:
        text.append("the recording is inverted (idle is low); it was decoded upside down")
    return text
