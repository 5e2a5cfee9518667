"""`concord flexray validate`: the configuration of a cluster, from wherever it is."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import msgspec
import tyro
from rich.table import Table

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_files import cluster_with_notes, file_endings
from concord.bus.flexray.levels import broken_rules
from concord.bus.flexray.presets import PRESETS, preset
from concord.bus.flexray.timing import SegmentTime, segments
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors

Level = Literal["2.1", "3.0.1", "physical"]
"""The levels of `concord.bus.flexray.levels`."""


class Derived(msgspec.Struct, frozen=True):
    """Values derived from a cluster's parameters; times in microseconds."""

    cycle_us: float
    cycles_repeat_ms: float
    static_slot_us: float
    static_frame_us: float
    minislot_us: float
    dynamic_frame_us: float
    dynamic_frame_minislots: int
    longest_dynamic_frames_per_cycle: int
    segments: list[SegmentTime]


def validate(
    cluster: tyro.conf.Positional[str],
    /,
    *,
    name: str | None = None,
    level: Level | None = None,
    json: bool = False,
) -> None:
    """Check a cluster against every range and constraint of FlexRay, and print its times.

    Args:
        cluster: A preset, or a file: TOML, FIBEX (.xml) or AUTOSAR (.arxml).
        name: Which cluster of a FIBEX or AUTOSAR file that has several.
        level: Refuse a cluster that breaks a rule of this edition of FlexRay, or of real clocks.
        json: Print one JSON object.
    """
    with user_errors():
        checked = read_cluster(cluster, name)
        broken = broken_rules(checked)
        if level is not None and broken[level]:
            raise ValueError(f"cluster {checked.name!r}, level {level}: {'; '.join(broken[level])}")
    times = derived(checked)
    if json:
        parts = [part._asdict() for part in times.segments]
        result = {
            "cluster": checked,
            **msgspec.structs.asdict(times),
            "segments": parts,
            "levels": broken,
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    kept = [name for name, rules in broken.items() if not rules]
    sys.stdout.write(f"cluster {checked.name}: valid; keeps levels {', '.join(kept) or 'none'}\n")
    if not checked.sync_slots:
        sys.stdout.write(
            "no sync nodes are stated (sync_slots); nodes on a wire need 2 to 15, so state them "
            "before you build\n"
        )
    for one, rules in broken.items():
        sys.stdout.writelines(f"level {one}: {rule}\n" for rule in rules)
    plain_console().print(_table(checked, times))


def read_cluster(source: str, name: str | None = None) -> Cluster:
    """Return a preset by its name, or the cluster in a file; `name` chooses one of several. The
    standard error gets a line for each value that the file leaves open.

    Raises:
        ValueError: there is no such preset, or the file is unreadable, or breaks a rule of FlexRay.
    """
    path = Path(source)
    if source in PRESETS:
        return preset(source)
    if path.suffix not in file_endings():
        raise ValueError(
            f"no cluster preset {source!r}; there are {', '.join(PRESETS)}, or give a file *.toml, "
            "*.xml (FIBEX) or *.arxml (AUTOSAR)"
        )
    cluster, notes = cluster_with_notes(path, name)
    sys.stderr.writelines(f"concord: {note}\n" for note in notes)
    return cluster


def derived(cluster: Cluster) -> Derived:
    """Return the values that follow from a cluster's parameters."""
    minislots = cluster.dynamic_slot_minislots(cluster.dynamic_payload_bytes)
    by_start = -(-cluster.latest_transmission_minislot // minislots)
    return Derived(
        cycle_us=cluster.cycle_us,
        cycles_repeat_ms=cluster.number_of_cycles * cluster.cycle_us / 1e3,
        static_slot_us=cluster.static_slot_us,
        static_frame_us=cluster.frame_us(cluster.static_payload_bytes),
        minislot_us=cluster.minislot_us,
        dynamic_frame_us=cluster.frame_us(cluster.dynamic_payload_bytes),
        dynamic_frame_minislots=minislots,
        longest_dynamic_frames_per_cycle=min(by_start, cluster.minislots // minislots),
        segments=list(segments(cluster)),
    )


def _table(cluster: Cluster, times: Derived) -> Table:
    grid = Table("what", "time", "how", show_edge=False)
    grid.columns[1].justify = "right"
    static, dynamic = cluster.static_payload_bytes, cluster.dynamic_payload_bytes
    rows = [
        ("cycle", times.cycle_us, f"{cluster.macroticks_per_cycle} macroticks"),
        ("macrotick", cluster.macrotick_us, f"bit rate {cluster.bit_rate_mbps:g} Mbit/s"),
        ("static slot", times.static_slot_us, f"{cluster.static_slots} in a cycle"),
        ("static frame", times.static_frame_us, f"{static} bytes"),
        ("minislot", times.minislot_us, f"{cluster.minislots} in a cycle"),
        (
            "longest dynamic frame",
            times.dynamic_frame_us,
            f"{dynamic} bytes, {times.dynamic_frame_minislots} minislots, "
            f"{times.longest_dynamic_frames_per_cycle} in a cycle",
        ),
    ]
    for what, time_us, how in rows:
        grid.add_row(what, f"{time_us:.2f} us", how)
    grid.add_section()
    for part in times.segments:
        length_us = part.end_us - part.start_us
        span = f"from {part.start_us:.1f} to {part.end_us:.1f} us"
        grid.add_row(part.name, f"{length_us:.2f} us", span)
    repeat = f"{cluster.number_of_cycles} cycles, then the cycle counter begins anew"
    grid.add_row("counter", f"{times.cycles_repeat_ms:.0f} ms", repeat)
    return grid


def ranges(numbers: Iterable[int]) -> list[str]:
    """Return rising numbers with runs drawn together: 4-6, 8."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return [str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs]


def write_new(path: Path, text: str) -> None:
    """Write a file that does not exist yet.

    Raises:
        ValueError: it exists, or cannot be written.
    """
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise ValueError(f"{path}: exists and is never written over; choose another name") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be written ({error.strerror})") from None
