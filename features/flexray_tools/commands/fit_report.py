"""The cluster behind a recording as text."""

from collections import defaultdict
from collections.abc import Iterable

from rich.table import Table

from concord.features.flexray_tools.commands.clusters import ranges
from concord.features.flexray_tools.recordings.fit import Fit
from concord.features.flexray_tools.recordings.multiplexing import Multiplex


def fit_lines(fitted: Fit) -> list[str]:
    """Return what a recording tells of its cluster, for people."""
    counts = fitted.cycles
    ticks = fitted.macrotick
    jitter = fitted.start_jitter_us
    slot = "" if ticks is None else f" ({ticks.static_slot_macroticks} macroticks)"
    minislot = "" if ticks is None else f" ({ticks.minislot_macroticks} macroticks)"
    pairs, right = fitted.dynamic_pairs, fitted.dynamic_pairs_explained
    return [
        f"{len(counts)} cycles, counters {_ranges(counts)}",
        f"static slots: {fitted.static_slots} (the highest static ID that was seen)",
        f"static slot pitch: {_us(fitted.static_slot_us)}{slot}",
        f"minislot: {_us(fitted.minislot_us)}{minislot}",
        f"macrotick: {_us(None if ticks is None else ticks.macrotick_us)}",
        "start jitter of static frames: "
        + ("unknown" if jitter is None else f"{jitter[0]:+.2f} to {jitter[1]:+.2f} us"),
        f"sync frames: {_ranges(fitted.sync_ids) or 'none'}; "
        f"startup frames: {_ranges(fitted.startup_ids) or 'none'}",
        f"dynamic slots of ceil(frame / minislot) + 1 minislots: right for {right} of {pairs} "
        "consecutive pairs",
    ]


def multiplex_table(multiplexing: Iterable[Multiplex]) -> Table:
    """Frame IDs with the same multiplexing in one row."""
    groups: dict[tuple[str, str], list[int]] = defaultdict(list)
    for entry in multiplexing:
        groups[entry.segment, _pattern(entry)].append(entry.frame_id)
    grid = Table("segment", "data seen in", "frame IDs", show_edge=False)
    for (segment, pattern), ids in groups.items():
        grid.add_row(segment, pattern, _ranges(ids))
    return grid


def _pattern(entry: Multiplex) -> str:
    sightings = f"{len(entry.cycles)} of {entry.recorded_cycles} cycles"
    if not entry.cycles:
        return f"none of {entry.recorded_cycles} cycles (null frames)"
    if entry.repetition is None:
        return sightings
    return f"{entry.base_cycle} modulo {entry.repetition} ({sightings})"


def _us(time_us: float | None) -> str:
    return "unknown" if time_us is None else f"{time_us:.2f} us"


def _ranges(numbers: Iterable[int]) -> str:
    return ", ".join(ranges(numbers))
