"""Logs of frames for `concord flexray`: what `decode`, `fit` and `wcrt` read beside waveforms, and
`statistics` and `spare`."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import tyro
from rich.table import Table

from concord.bus.bus import Captured
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_files import cluster_to_toml
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.frame import encode
from concord.bus.flexray.slot_file import checked_slots, slots_to_toml
from concord.bus.pcap import write_pcap
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.features.flexray_tools.commands.clusters import ranges, read_cluster, write_new
from concord.features.flexray_tools.commands.fit_report import fit_lines, multiplex_table
from concord.features.flexray_tools.frame_logs.frames import (
    BAD_FRAME,
    BAD_HEADER,
    NULL,
    PREAMBLE,
    STARTUP,
    SYNC,
    channel_name,
    frame_of,
)
from concord.features.flexray_tools.frame_logs.log_files import FrameLog, first_frames
from concord.features.flexray_tools.frame_logs.log_fit import (
    ASSUMED_RATE_MBPS,
    ONLY_A_WAVEFORM,
    SAMPLE_FRAMES,
    FittedLog,
    fit_log,
    log_slots,
)
from concord.features.flexray_tools.frame_logs.spare_slots import network_in_spare_slots
from concord.features.flexray_tools.frame_logs.tally import (
    FrameStatistics,
    LogTally,
    static_border,
    tallied,
)
from concord.features.flexray_tools.recordings.recorded_cluster import recorded_cluster

Log = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
Columns = Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")]
_SHOWN_BYTES = 8
_MARKS = {NULL: "null", SYNC: "sync", STARTUP: "startup"}
_HEADING = (
    f"{'time us':>14} channel {'cycle':>5} {'ID':>9} {'segment':<7} {'bytes':>5} {'kind':<12} "
    f"{'wrong CRC':<12} payload"
)
NOT_IN_FRAMES = (
    "frames do not tell: bit rate and start sequence ({rate:g} Mbit/s is taken; --bit-rate states "
    "another), symbols, glitches, idle times, and jitter below the logger's clock; a waveform does"
)


def surveyed(log: FrameLog) -> tuple[LogTally, int]:
    """Return the counts of a log, and its highest static ID (0 on a bus without cycles)."""
    sample = first_frames(log, SAMPLE_FRAMES)
    tally = tallied(log.blocks(), sample)
    return tally, static_border(tally, sample) if tally.kind == "flexray" else 0


def print_decoded(log: FrameLog, pcap: Path | None, json: bool) -> None:
    """Print the frames of a log, one at a time, and their counts.

    Raises:
        ValueError: the log cannot be read, or the capture cannot be written.
    """
    tally, border = surveyed(log)
    if pcap is not None:
        if tally.kind != "flexray":
            raise ValueError(f"--pcap {pcap}: {log.path} has frames of CAN; leave --pcap out")
        write_pcap(pcap, _captured(log))
    if json:
        _print_json(log, tally, border)
        return
    sys.stdout.write(f"{_HEADING}\n")
    for block in log.blocks():
        sys.stdout.writelines(_line(row, border, block.kind) for row in block.rows())
    sys.stdout.writelines(f"{line}\n" for line in _decoded_lines(log, tally, border))


def _captured(log: FrameLog) -> Iterator[Captured]:
    for block in log.blocks():
        for time_ns, channel, frame_id, cycle, flags, payload in block.rows():
            name = channel_name(channel)
            whole = payload + bytes(len(payload) % 2)
            data = encode(frame_of(frame_id, cycle, flags, whole), name)
            if flags & (BAD_FRAME | BAD_HEADER):
                data = data[:-1] + bytes([data[-1] ^ 1])
            yield Captured(time_ns / 1e3, data, name)


def _line(row: tuple[int, int, int, int, int, bytes], border: int, kind: str) -> str:
    time_ns, channel, frame_id, cycle, flags, payload = row
    segment = "" if kind == "can" else "static" if frame_id <= border else "dynamic"
    marks = " ".join(name for bit, name in _MARKS.items() if flags & bit) if flags else ""
    wrong = ""
    if flags & (BAD_HEADER | BAD_FRAME):
        wrong = "+".join(
            name for bit, name in ((BAD_HEADER, "header"), (BAD_FRAME, "frame")) if flags & bit
        )
    cut = "..." if len(payload) > _SHOWN_BYTES else ""
    return (
        f"{time_ns / 1e3:14.3f} {channel_name(channel):<7} {cycle:5d} {frame_id:9d} {segment:<7} "
        f"{len(payload):5d} {marks:<12} {wrong:<12} {payload[:_SHOWN_BYTES].hex()}{cut}\n"
    )


def _print_json(log: FrameLog, tally: LogTally, border: int) -> None:
    """Print one object, a frame at a time, so that a long log needs little memory."""
    encoder = msgspec.json.Encoder()
    write = sys.stdout.write
    write('{"frames":[')
    separator = ""
    for block in log.blocks():
        for time_ns, channel, frame_id, cycle, flags, payload in block.rows():
            row = {
                "time_us": time_ns / 1e3,
                "channel": channel_name(channel),
                "frame_id": frame_id,
                "cycle": cycle,
                "segment": "static" if frame_id <= border else "dynamic",
                "null": bool(flags & NULL),
                "sync": bool(flags & SYNC),
                "startup": bool(flags & STARTUP),
                "payload_preamble": bool(flags & PREAMBLE),
                "header_crc_ok": not flags & BAD_HEADER,
                "frame_crc_ok": not flags & BAD_FRAME,
                "payload": payload.hex(),
            }
            if block.kind == "can":
                row = {key: row[key] for key in ("time_us", "frame_id", "payload")}
            write(separator + encoder.encode(row).decode())
            separator = ","
    figures = {
        "bus": tally.kind,
        "frame_count": tally.frames,
        "header_crc_wrong": tally.header_wrong,
        "frame_crc_wrong": tally.frame_wrong,
        "null": sum(one.null for one in tally.rows),
        "static_slots": border,
        "skipped": _skipped(log),
    }
    write("]," + encoder.encode(figures).decode()[1:] + "\n")


def _skipped(log: FrameLog) -> dict[str, int]:
    return {what: count for what, count in sorted(log.skipped.items()) if count}


def _decoded_lines(log: FrameLog, tally: LogTally, border: int) -> list[str]:
    text = [f"{tally.frames} frames of {log.path.name} in {tally.span_us / 1e6:.6g} s"]
    if tally.kind == "flexray":
        static = sum(one.frames for one in tally.rows if one.frame_id <= border)
        dynamic = sum(one.frames for one in tally.rows if one.frame_id > border)
        null = sum(one.null for one in tally.rows)
        text = [
            f"{text[0]}: {static} static (IDs up to {border}), {dynamic} dynamic; {null} null "
            "frames",
            f"header CRC: {tally.header_wrong} wrong; frame CRC: {tally.frame_wrong} wrong, as the "
            "log says",
        ]
    return text + _skipped_lines(log)


def _skipped_lines(log: FrameLog) -> list[str]:
    there = ", ".join(f"{count} {what}" for what, count in _skipped(log).items())
    return [f"no frames: {there}"] if there else []


def write_fit(
    found: FittedLog, name: str, out: Path | None, slots: Path | None, cycle_us: float | None
) -> None:
    """Write the cluster and the slot table behind a log.

    Raises:
        ValueError: the log does not tell the cluster, or a file cannot be written.
    """
    if out is not None:
        made = recorded_cluster(found.decoding, found.fit, name, cycle_us)
        write_new(out, cluster_to_toml(made.cluster, made.chosen + ONLY_A_WAVEFORM))
    if slots is not None:
        write_new(slots, slots_to_toml(log_slots(found.tally, found.fit.static_slots)))


def print_fit(found: FittedLog, out: Path | None, json: bool) -> None:
    """Print the cluster behind a log."""
    if json:
        sys.stdout.write(msgspec.json.encode(_fit_result(found)).decode() + "\n")
        return
    for line in (*fit_lines(found.fit), *_length_lines(found)):
        sys.stdout.write(f"{line}\n")
    for name, entries in found.multiplexing.items():
        if len(found.multiplexing) > 1:
            sys.stdout.write(f"channel {name}:\n")
        plain_console().print(multiplex_table(entries))
    sys.stdout.write(NOT_IN_FRAMES.format(rate=found.decoding.bit_rate_mbps) + "\n")
    pairs, right = found.fit.dynamic_pairs, found.fit.dynamic_pairs_explained
    if 2 * right < pairs:
        sys.stdout.write(
            "few starts of dynamic frames follow from the frames before: if the log has the times "
            "of their ends, use --stamps end\n"
        )
    if out is not None:
        sys.stdout.write(f"the cluster is in {out}; it marks the parameters that were chosen\n")


def _fit_result(found: FittedLog) -> dict[str, Any]:
    ticks = found.fit.macrotick
    return {
        **found.fit._asdict(),
        "macrotick": None if ticks is None else ticks._asdict(),
        "multiplexing": [one._asdict() for one in found.fit.multiplexing],
        "channels": {
            name: [one._asdict() for one in entries] for name, entries in found.multiplexing.items()
        },
        "payload_bytes": {
            name: {
                row.frame_id: row.payload_bytes
                for row in found.tally.rows
                if channel_name(row.channel) == name
            }
            for name in found.multiplexing
        },
        "cycle_us": found.tally.cycle_us,
        "not_in_frames": [*ONLY_A_WAVEFORM, "symbols", "glitches"],
    }


def _length_lines(found: FittedLog) -> Iterator[str]:
    border = found.fit.static_slots
    static = {row.payload_bytes for row in found.tally.rows if row.frame_id <= border}
    dynamic = [row.payload_bytes for row in found.tally.rows if row.frame_id > border]
    lengths = sorted({size for span in static for size in span})
    yield f"payload of static frames: {', '.join(map(str, lengths)) or 'none'} bytes"
    if dynamic:
        shortest, longest = min(one for one, _ in dynamic), max(one for _, one in dynamic)
        yield f"payload of dynamic frames: {shortest} to {longest} bytes"
    if found.tally.cycle_us is not None:
        yield f"cycle: {found.tally.cycle_us:.3f} us"


def statistics(
    log: Log, /, *, columns: Columns = None, bit_rate: float | None = None, json: bool = False
) -> None:
    """Count over a log of frames: load, jitter, lost cycles and null frames of every ID.

    Args:
        log: pcap, pcapng, BLF, or CSV with a line for each frame.
        columns: Columns file of a CSV log.
        bit_rate: Bit rate in Mbit/s, for the load of FlexRay; 10 otherwise.
        json: Print one JSON object.
    """
    with user_errors():
        frames = FrameLog(log, columns)
        tally, border = surveyed(frames)
    rate = bit_rate or ASSUMED_RATE_MBPS
    if json:
        result = {
            **{field: getattr(tally, field) for field in _PLAIN},
            "recorded_cycles": int(tally.recorded.sum()),
            "static_slots": border,
            "load": _loads(tally, rate),
            "skipped": _skipped(frames),
            "frame_ids": [_row_result(one, border) for one in tally.rows],
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    plain_console().print(_statistics_table(tally, border))
    for line in (*_total_lines(tally, rate), *_skipped_lines(frames)):
        sys.stdout.write(f"{line}\n")


_PLAIN = (
    "kind", "frames", "header_wrong", "frame_wrong", "span_us", "cycle_us", "lost_cycles",
)  # fmt: skip


def _loads(tally: LogTally, rate: float) -> dict[str, float]:
    """Return the share of the time in which each channel carries bits; none of CAN, whose bits on
    the wire depend on its stuff bits."""
    cycles = int(tally.recorded.sum())
    time_us = cycles * tally.cycle_us if tally.cycle_us else tally.span_us
    if tally.kind != "flexray" or time_us <= 0:
        return {}
    return {
        channel_name(number): int(bits) / rate / time_us
        for number, bits in enumerate(tally.bits)
        if bits
    }


def _row_result(one: FrameStatistics, border: int) -> dict[str, Any]:
    return {
        "channel": channel_name(one.channel),
        "frame_id": one.frame_id,
        "frames": one.frames,
        "null": one.null,
        "payload_bytes": one.payload_bytes,
        "gap_us": one.gap_us,
        "jitter_us": one.jitter_us,
        "lost": one.lost if one.frame_id <= border else None,
    }


def _statistics_table(tally: LogTally, border: int) -> Table:
    grid = Table("channel", "ID", "frames", "null", "bytes", "mean gap us", show_edge=False)
    flexray = tally.kind == "flexray"
    grid.add_column("jitter us" if flexray else "gaps us")
    if flexray:
        grid.add_column("lost")
    for one in tally.rows:
        shortest, longest = one.payload_bytes
        span = one.jitter_us
        if not flexray and one.gap_us is not None:
            span = one.gap_us[0], one.gap_us[2]
        grid.add_row(
            channel_name(one.channel),
            str(one.frame_id),
            str(one.frames),
            str(one.null),
            str(longest) if shortest == longest else f"{shortest} to {longest}",
            "" if one.gap_us is None else f"{one.gap_us[1]:.2f}",
            "" if span is None else f"{span[0]:.2f} to {span[1]:.2f}",
            *([str(one.lost) if one.frame_id <= border else ""] if flexray else []),
        )
    return grid


def _total_lines(tally: LogTally, rate: float) -> Iterator[str]:
    yield f"{tally.frames} frames in {tally.span_us / 1e6:.6g} s"
    if tally.kind != "flexray":
        return
    counters = np.flatnonzero(tally.recorded).tolist()
    yield (
        f"{int(tally.recorded.sum())} cycles, counters {', '.join(ranges(counters))}; "
        f"{tally.lost_cycles} cycles are missing between them"
    )
    null = sum(one.null for one in tally.rows)
    yield f"null frames: {null}; wrong header CRC: {tally.header_wrong}; wrong frame CRC: " + str(
        tally.frame_wrong
    )
    loads = _loads(tally, rate)
    shown = ", ".join(f"{100 * load:.1f} % of channel {name}" for name, load in loads.items())
    yield f"load at {rate:g} Mbit/s: {shown or 'unknown, for the log has less than two cycles'}"


def spare(
    log: Log,
    /,
    *,
    cluster: str,
    name: str | None = None,
    nodes: int = 6,
    share_bytes: int = 24,
    columns: Columns = None,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    json: bool = False,
) -> None:
    """Find static slots that a recorded bus leaves free, and put a network of concord in them.

    `concord flexray plan` prints the bytes of a share. With --out, `concord run --cluster CLUSTER
    --slots FILE.toml` runs the network beside the frames of the bus.

    Args:
        log: pcap, pcapng, BLF, or CSV with a line for each frame.
        cluster: A preset, or a file, as `concord flexray fit --out` writes it.
        name: Which cluster of a FIBEX or AUTOSAR file that has several.
        nodes: Nodes of the network.
        share_bytes: Bytes of the longest share.
        columns: Columns file of a CSV log.
        out: Slot table (.toml) to write: the network, and the frames of the bus as other stations.
        json: Print one JSON object.
    """
    with user_errors():
        if nodes < 1 or share_bytes < 1:
            raise ValueError(
                f"--nodes {nodes} --share-bytes {share_bytes}: both are numbers from 1 on"
            )
        bus = read_cluster(cluster, name)
        found = network_in_spare_slots(_tally_on(log, bus, columns), bus, nodes, share_bytes)
        if out is not None:
            write_new(out, slots_to_toml(found.slots))
    own = [slot for slot in found.slots if slot.node < nodes]
    if json:
        result = {**found._asdict(), "slots": own}
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    when = "every cycle" if found.repetition == 1 else f"one of {found.repetition} cycles"
    for line in (
        f"{len(found.free_slots)} of {bus.static_slots} static slots have no frame: "
        + (", ".join(ranges(found.free_slots)) or "none"),
        f"{nodes} nodes with shares of {share_bytes} bytes ({found.frames_per_share} frames each) "
        f"fit in {len({slot.frame_id for slot in own})} slots, each in {when}",
        f"age of information: a reading is at all neighbours {found.age_us / 1e3:.4g} ms after it "
        "was taken at the latest; over more links, that time for each link",
        *([f"the slot table is in {out}"] if out is not None else []),
    ):
        sys.stdout.write(f"{line}\n")


def slots_of_log(log: Path, cluster: Cluster, columns: Path | None) -> tuple[MessageSlot, ...]:
    """Return the slots that a log shows, on a cluster.

    Raises:
        ValueError: the log cannot be read, or is not of the cluster.
    """
    tally = _tally_on(log, cluster, columns)
    return checked_slots(log_slots(tally, cluster.static_slots, cluster), cluster)


def _tally_on(log: Path, cluster: Cluster, columns: Path | None) -> LogTally:
    tally = fit_log(FrameLog(log, columns), cluster.bit_rate_mbps, cluster.static_slots).tally
    try:
        checked_slots(log_slots(tally, cluster.static_slots, cluster), cluster)
    except ValueError as error:
        raise ValueError(
            f"{log}: {error}; name the cluster of the log, not {cluster.name!r}"
        ) from None
    return tally
