"""The FlexRay panel: the shown cycle to scale, past cycles as a raster; one SVG as text."""

from collections.abc import Sequence
from functools import lru_cache

from concord.bus.bus import Bus
from concord.dashboard.frames.frame import BusCycle, StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.timeline_marks import (
    BAR,
    LEFT,
    NUMBERS_END,
    ROW,
    TOP,
    WIDTH,
    Axis,
    legend,
    missed_and_rejected,
    names_of_trains,
    number,
    readable,
    silent_slot,
    slot,
)
from concord.dashboard.theme import Theme, css, mixed

RASTER_ROWS = 11


def past_cycles(past: Sequence[StepFrame], shown: BusCycle) -> list[BusCycle]:
    """Return cycles of these frames before the shown one, the newest first."""
    wanted = -(-RASTER_ROWS // max(1, len(past[-1].cycles))) + 1
    cycles = [cycle for frame in past[-wanted:] for cycle in frame.cycles]
    return [cycle for cycle in reversed(cycles) if cycle.cycle < shown.cycle][:RASTER_ROWS]


class TimelineView:
    """Draws the bus of one run, each cycle with the schedule that it had."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage

    def draw(
        self,
        theme: Theme,
        frame: StepFrame,
        past: Sequence[BusCycle],
        cycle: BusCycle,
        now_us: float,
        selected: int | None,
    ) -> str:
        """The panel: `cycle` of `frame` at time `now_us`, and `past` cycles, newest first."""
        past = past[:RASTER_ROWS]
        # One scale for all: a cycle from before a change of settings may be longer.
        axis = Axis(max(one.bus.segments()[-1].end_us for one in (cycle, *past)))
        height = TOP + BAR + 12 + ROW * RASTER_ROWS + 4
        parts = [
            '<svg data-testid="timeline" data-marks="slots of the shown cycle" '
            f'viewBox="0 0 {WIDTH:g} {height:g}" width="100%" '
            f'style="display:block;font-family:inherit" preserveAspectRatio="xMidYMin meet">',
            f"<style>.slot{{cursor:pointer}}.slot:hover rect{{stroke:{css(theme.text)};"
            f"stroke-width:2}}</style>",
            _headings(axis, theme, cycle.bus),
            self._bar(axis, theme, cycle, now_us, selected),
            _raster(axis, theme, past),
            "</svg>",
        ]
        return readable("".join(parts)) + legend(theme, cycle, frame.cycles)

    def _bar(
        self,
        axis: Axis,
        theme: Theme,
        cycle: BusCycle,
        now_us: float,
        selected: int | None,
    ) -> str:
        """Return the cycle to scale: segments, slots with their owners, minislots, the time."""
        parts = [
            f'<text class="wide" x="{NUMBERS_END:g}" y="{TOP + 15:g}" font-size="11.5" '
            f'text-anchor="end" fill="{css(theme.text)}">cycle</text>'
            + number(cycle.bus_cycle, TOP + 29, css(theme.text), 'data-testid="bus-cycle"')
        ]
        for part in cycle.bus.segments():
            x, wide = (
                axis.x(part.start_us),
                axis.x(part.end_us) - axis.x(part.start_us),
            )
            idle = part.name not in ("static", "dynamic")
            fill = mixed(theme.faint, theme.panel, 0.8 if idle else 0.35)
            parts.append(
                f'<rect x="{x:.1f}" y="{TOP:g}" width="{wide:.1f}" height="{BAR:g}" '
                f'fill="{css(fill)}"><title>{part.name}: {part.start_us:.0f} to '
                f"{part.end_us:.0f} us</title></rect>"
            )
        parts.append(_grid_of_slots(axis, theme, cycle.bus))
        names = self._stage.names
        parts += [
            silent_slot(axis, theme, names[node], node, cycle.bus.own_slot_us(node, cycle.cycle))
            for node in cycle.silent
        ]
        for frame in cycle.frames:
            state = "past" if frame.end_us < now_us else "future"
            if frame.start_us <= now_us <= frame.end_us:
                state = "now"
            parts.append(
                slot(
                    axis,
                    theme,
                    names[frame.node],
                    frame,
                    state,
                    frame.node == selected,
                    frame.node in cycle.missed,
                    cycle.bus.channels,
                )
            )
        parts.append(names_of_trains(axis, theme, names, cycle))
        if now_us > 0:
            x = axis.x(now_us)
            parts.append(
                f'<path d="M{x:.1f} {TOP - 4:g}V{TOP + BAR + 4:g}" stroke="{css(theme.text)}" '
                'stroke-width="2" pointer-events="none"/>'
            )
        return "".join(parts)


def _headings(axis: Axis, theme: Theme, bus: Bus) -> str:
    names = {"static": "STATIC SEGMENT", "dynamic": "DYNAMIC SEGMENT"}
    short = {"symbol window": "SW", "network idle time": "NIT"}
    text = []
    for part in bus.segments():
        wide = axis.x(part.end_us) - axis.x(part.start_us)
        label = names.get(part.name, short.get(part.name, part.name))
        if wide < 7.2 * len(label):
            label = label.split()[0] if wide > 7.2 * len(label.split()[0]) else ""
        text.append(
            f'<text x="{axis.x(part.start_us):.1f}" y="15" font-size="10.5" '
            f'fill="{css(theme.quiet)}">{label}</text>'
        )
    return "".join(text)


@lru_cache(maxsize=8)
def _grid_of_slots(axis: Axis, theme: Theme, bus: Bus) -> str:
    """Where slots begin: ticks for static slots and for minislots, in every cycle."""
    ends, minislots = bus.marks_us()
    path: list[str] = []
    if ends and axis.x(ends[0]) - LEFT > 3:
        path += [f"M{axis.x(end):.1f} {TOP:g}v{BAR:g}" for end in ends]
    if minislots:
        width_us = minislots[1] - minislots[0] if len(minislots) > 1 else axis.span_us
        stride = max(1, round(3.0 / max(axis.x(width_us) - LEFT, 1e-6)))
        for start in minislots[::stride]:
            path.append(f"M{axis.x(start):.1f} {TOP + BAR - 5:g}v5")
    if not path:
        return ""
    return f'<path d="{"".join(path)}" stroke="{css(theme.panel)}" stroke-width="1"/>'


def _raster(axis: Axis, theme: Theme, past: Sequence[BusCycle]) -> str:
    """One row per past cycle and one path per row and colour."""
    parts: list[str] = []
    for row, cycle in enumerate(past):
        y = TOP + BAR + 12 + row * ROW
        share = 1.0 - 0.065 * row
        if row in (0, len(past) - 1, RASTER_ROWS // 2):
            parts.append(number(cycle.bus_cycle, y + ROW - 2, css(theme.quiet)))
        for segment, colour in (("static", theme.seeing), ("dynamic", theme.estimate)):
            boxes = [
                axis.box(f.start_us, f.end_us, y) for f in cycle.frames if f.segment == segment
            ]
            if boxes:
                shade = css(mixed(colour, theme.panel, 0.75 * share))
                parts.append(f'<path d="{"".join(boxes)}" fill="{shade}"/>')
        silent = [axis.box(*cycle.bus.own_slot_us(node, cycle.cycle), y) for node in cycle.silent]
        if silent:
            shade = css(mixed(theme.down, theme.panel, share))
            parts.append(f'<path d="{"".join(silent)}" fill="{shade}"/>')
        parts.append(missed_and_rejected(axis, theme, cycle, y))
    return "".join(parts)
