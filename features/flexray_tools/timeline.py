"""One communication cycle as text, for people."""

from collections.abc import Iterable

from concord.bus.bus import Transmission
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.timing import bus_load, segments

BAR_COLUMNS = 40


def timeline(cluster: Cluster, cycle: int, transmissions: Iterable[Transmission]) -> str:
    """A table of the segments and frames of a cycle in order of time, with a bar for each.

    Times in microseconds from the beginning of the cycle; `cycle` is counted without wrapping.
    """
    frames = sorted(transmissions, key=lambda frame: (frame.start_us, frame.frame_id))
    load = max((bus_load(cluster, frames, channel) for channel in cluster.channels), default=0.0)
    lines = [
        f"cycle {cycle} (count {cycle % cluster.number_of_cycles}) of cluster {cluster.name}: "
        f"{cluster.cycle_us:g} us, {len(frames)} frames, bus load {100 * load:.1f} %",
        f"{'start us':>10} {'end us':>10}  {'what':<24} {'node':>4} {'bytes':>5}  channel",
    ]
    for part in segments(cluster):
        bar = _bar(cluster, part.start_us, part.end_us, "-")
        lines.append(f"{part.start_us:10.1f} {part.end_us:10.1f}  {part.name:<39} {bar}")
        for frame in frames:
            if frame.segment == part.name:
                lines.append(_frame_line(cluster, frame))
    return "\n".join(lines) + "\n"


def _frame_line(cluster: Cluster, frame: Transmission) -> str:
    place = f"minislot {frame.minislot}" if frame.minislot else ""
    what = f"  ID {frame.frame_id} {place}"
    bar = _bar(cluster, frame.start_us, frame.end_us, "#")
    return (
        f"{frame.start_us:10.1f} {frame.end_us:10.1f}  {what:<24} {frame.node:4d} "
        f"{frame.payload_bytes:5d}  {frame.channel:<2} {bar}"
    )


def _bar(cluster: Cluster, start_us: float, end_us: float, mark: str) -> str:
    """A line of the cycle's length in which the columns of this time are marked, at least one."""
    scale = BAR_COLUMNS / cluster.cycle_us
    first = min(int(start_us * scale), BAR_COLUMNS - 1)
    last = max(first + 1, round(end_us * scale))
    return "|" + " " * first + mark * (last - first) + " " * (BAR_COLUMNS - last) + "|"
