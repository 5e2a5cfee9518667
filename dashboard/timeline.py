"""The FlexRay panel: the shown cycle to scale, past cycles as a raster; one SVG as text."""

from collections.abc import Sequence
from html import escape
from itertools import groupby

from bus.timing import SegmentTime, bus_load, segments
from dashboard.frame import BusCycle, Frame
from dashboard.stage import Stage
from dashboard.theme import Theme, css, mixed

WIDTH, LEFT, RIGHT = 1000.0, 62.0, 8.0
TOP, BAR, ROW = 20.0, 34.0, 9.0
RASTER_ROWS = 11


class TimelineView:
    """Draws the bus of one run; knows its slots and segments."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        cluster = stage.cluster
        senders = max(len(row) for row in stage.plan.schedule.static_table)
        if cluster is None:
            self._span = float(max(senders, 1))
            self._segments: tuple[SegmentTime, ...] = (SegmentTime("static", 0.0, self._span),)
        else:
            self._span, self._segments = cluster.cycle_us, segments(cluster)

    def draw(
        self,
        theme: Theme,
        frame: Frame,
        past: Sequence[BusCycle],
        cycle: BusCycle,
        now_us: float,
        selected: int | None,
    ) -> str:
        """The panel: `cycle` of `frame` at time `now_us`, and `past` cycles, newest first."""
        lost = self._lost_senders(frame) if cycle is frame.cycles[-1] else set()
        height = TOP + BAR + 12 + ROW * RASTER_ROWS + 4
        parts = [
            f'<svg data-testid="timeline" viewBox="0 0 {WIDTH:g} {height:g}" width="100%" '
            f'style="display:block;font-family:inherit" preserveAspectRatio="xMidYMin meet">',
            f"<style>.slot{{cursor:pointer}}.slot:hover rect{{stroke:{css(theme.text)};"
            f"stroke-width:2}}</style>",
            self._headings(theme),
            self._bar(theme, cycle, now_us, selected, lost),
            self._raster(theme, past),
            "</svg>",
            self._legend(theme, cycle),
        ]
        return "".join(parts)

    def _x(self, time_us: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * time_us / self._span

    def _lost_senders(self, frame: Frame) -> set[int]:
        return {int(sender) for sender in self._stage.heard[frame.lost, 1]}

    def _headings(self, theme: Theme) -> str:
        names = {"static": "STATIC SEGMENT", "dynamic": "DYNAMIC SEGMENT"}
        short = {"symbol window": "SW", "network idle time": "NIT"}
        text = []
        for part in self._segments:
            wide = self._x(part.end_us) - self._x(part.start_us)
            label = names.get(part.name, short.get(part.name, part.name))
            if wide < 7.2 * len(label):
                label = label.split()[0] if wide > 7.2 * len(label.split()[0]) else ""
            text.append(
                f'<text x="{self._x(part.start_us):.1f}" y="13" font-size="10.5" '
                f'fill="{css(theme.quiet)}">{label}</text>'
            )
        return "".join(text)

    def _bar(
        self, theme: Theme, cycle: BusCycle, now_us: float, selected: int | None, lost: set[int]
    ) -> str:
        """The cycle to scale: segments, slots with their owners, minislots, the time."""
        parts = [
            f'<text x="6" y="{TOP + 15:g}" font-size="11.5" fill="{css(theme.text)}">cycle</text>'
            f'<text x="6" y="{TOP + 29:g}" font-size="11.5" fill="{css(theme.text)}" '
            f'data-testid="bus-cycle">{cycle.cycle}</text>'
        ]
        for part in self._segments:
            x, wide = self._x(part.start_us), self._x(part.end_us) - self._x(part.start_us)
            idle = part.name not in ("static", "dynamic")
            fill = mixed(theme.faint, theme.panel, 0.8 if idle else 0.35)
            parts.append(
                f'<rect x="{x:.1f}" y="{TOP:g}" width="{wide:.1f}" height="{BAR:g}" '
                f'fill="{css(fill)}"><title>{part.name}: {part.start_us:.0f} to '
                f"{part.end_us:.0f} us</title></rect>"
            )
        parts.append(self._grid_of_slots(theme))
        parts += [self._silent_slot(theme, cycle, node) for node in cycle.silent]
        for frame in cycle.frames:
            state = "past" if frame.end_us < now_us else "future"
            if frame.start_us <= now_us <= frame.end_us:
                state = "now"
            parts.append(
                self._slot(theme, frame, state, frame.node == selected, frame.node in lost)
            )
        parts.append(self._names_of_trains(cycle, theme))
        if now_us > 0:
            x = self._x(now_us)
            parts.append(
                f'<path d="M{x:.1f} {TOP - 4:g}V{TOP + BAR + 4:g}" stroke="{css(theme.text)}" '
                'stroke-width="2" pointer-events="none"/>'
            )
        return "".join(parts)

    def _grid_of_slots(self, theme: Theme) -> str:
        """Where slots begin: ticks for static slots and for minislots."""
        cluster = self._stage.cluster
        if cluster is None:
            return ""
        path: list[str] = []
        slot_px = self._x(cluster.static_slot_us) - LEFT
        if slot_px > 3:
            ends = [k * cluster.static_slot_us for k in range(1, cluster.static_slots)]
            path += [f"M{self._x(end):.1f} {TOP:g}v{BAR:g}" for end in ends]
        stride = max(1, round(3.0 / max(self._x(cluster.minislot_us) - LEFT, 1e-6)))
        for number in range(1, cluster.minislots + 1, stride):
            path.append(f"M{self._x(cluster.minislot_start_us(number)):.1f} {TOP + BAR - 5:g}v5")
        return f'<path d="{"".join(path)}" stroke="{css(theme.panel)}" stroke-width="1"/>'

    def _names_of_trains(self, cycle: BusCycle, theme: Theme) -> str:
        """The name of whoever sends many frames in a row, each too short for it."""
        text = []
        for node, frames in groupby(cycle.frames, key=lambda frame: frame.node):
            train, name = list(frames), self._stage.names[node]
            x, right = self._x(train[0].start_us), self._x(train[-1].end_us)
            single = self._x(train[0].end_us) - x
            if len(train) > 1 and single < _room(_short(name)) and right - x > _room(name):
                text.append(
                    f'<text x="{(x + right) / 2:.1f}" y="{TOP + BAR / 2 + 4:g}" font-size="11" '
                    f'text-anchor="middle" fill="{css(theme.text)}" stroke="{css(theme.panel)}" '
                    f'stroke-width="3" paint-order="stroke" pointer-events="none">'
                    f"{escape(name)}</text>"
                )
        return "".join(text)

    def _slot(self, theme: Theme, frame, state: str, is_selected: bool, is_lost: bool) -> str:
        name = self._stage.names[frame.node]
        x, right = self._x(frame.start_us), self._x(frame.end_us)
        wide = max(right - x - 0.6, 0.8)
        colour = theme.seeing if frame.segment == "static" else theme.estimate
        if state == "now":
            colour = theme.sending
        shown = mixed(colour, theme.panel, 0.32 if state == "future" else 1.0)
        stroke = f' stroke="{css(theme.selection)}" stroke-width="2"' if is_selected else ""
        note = "; did not reach everybody" if is_lost else ""
        text = ""
        if wide > _room(_short(name)):
            size = 10 if wide < 22 else 11
            ink = theme.panel if state != "future" else theme.quiet
            text = (
                f'<text x="{x + wide / 2:.1f}" y="{TOP + BAR / 2 + 4:g}" font-size="{size}" '
                f'text-anchor="middle" fill="{css(ink if theme.dark else _INK[state])}">'
                f"{escape(_short(name))}</text>"
            )
        mark = ""
        if is_lost:
            mark = (
                f'<rect x="{x:.1f}" y="{TOP + BAR - 5:g}" width="{wide:.1f}" height="5" '
                f'fill="{css(theme.down)}"/>'
            )
        return (
            f'<g class="slot" data-node="{frame.node}"><title>node {escape(name)}: frame '
            f"{frame.frame_id}, {frame.payload_bytes} bytes, {frame.start_us:.1f} to "
            f"{frame.end_us:.1f} us{note}</title>"
            f'<rect x="{x:.1f}" y="{TOP + 2:g}" width="{wide:.1f}" height="{BAR - 4:g}" rx="1.5" '
            f'fill="{css(shown)}"{stroke}/>{text}{mark}</g>'
        )

    def _silent_slot(self, theme: Theme, cycle: BusCycle, node: int) -> str:
        """The slot of an owner that sent nothing: an empty frame with a cross."""
        cluster, table = self._stage.cluster, self._stage.plan.table
        if cluster is None or table is None:
            row = self._stage.plan.schedule.static_senders(cycle.cycle)
            start_us, end_us = float(row.index(node)), row.index(node) + 1.0
        else:
            rows = len(self._stage.plan.schedule.static_table)
            owned = [s for s in table.static_slots(cycle.cycle % rows) if s.node == node]
            start_us = cluster.slot_start_us(min(s.frame_id for s in owned))
            end_us = cluster.slot_start_us(max(s.frame_id for s in owned)) + cluster.static_slot_us
        x, wide = self._x(start_us), self._x(end_us) - self._x(start_us)
        name = escape(self._stage.names[node])
        middle, y = x + wide / 2, TOP + BAR / 2
        arm = min(4.0, wide / 3)
        return (
            f'<g class="slot" data-node="{node}"><title>node {name}: silent</title>'
            f'<rect x="{x + 1:.1f}" y="{TOP + 3:g}" width="{max(wide - 2, 0.8):.1f}" '
            f'height="{BAR - 6:g}" fill="{css(theme.panel)}" stroke="{css(theme.down)}" '
            f'stroke-width="1.5"/><path d="M{middle - arm:.1f} {y - arm:g}l{2 * arm:.1f} '
            f'{2 * arm:.1f}m0 {-2 * arm:.1f}l{-2 * arm:.1f} {2 * arm:.1f}" '
            f'stroke="{css(theme.down)}" stroke-width="1.5"/></g>'
        )

    def _raster(self, theme: Theme, past: Sequence[BusCycle]) -> str:
        """One row per past cycle and one path per row and colour."""
        parts: list[str] = []
        for number, cycle in enumerate(past[:RASTER_ROWS]):
            y = TOP + BAR + 12 + number * ROW
            share = 1.0 - 0.065 * number
            if number in (0, len(past[:RASTER_ROWS]) - 1, RASTER_ROWS // 2):
                parts.append(
                    f'<text x="6" y="{y + ROW - 2:g}" font-size="9" fill="{css(theme.quiet)}">'
                    f"{cycle.cycle}</text>"
                )
            for segment, colour in (("static", theme.seeing), ("dynamic", theme.estimate)):
                boxes = [
                    self._box(f.start_us, f.end_us, y) for f in cycle.frames if f.segment == segment
                ]
                if boxes:
                    shade = css(mixed(colour, theme.panel, 0.75 * share))
                    parts.append(f'<path d="{"".join(boxes)}" fill="{shade}"/>')
            silent = [self._silent_box(cycle, node, y) for node in cycle.silent]
            if silent:
                shade = css(mixed(theme.down, theme.panel, share))
                parts.append(f'<path d="{"".join(silent)}" fill="{shade}"/>')
        return "".join(parts)

    def _silent_box(self, cycle: BusCycle, node: int, y: float) -> str:
        cluster, table = self._stage.cluster, self._stage.plan.table
        if cluster is None or table is None:
            place = self._stage.plan.schedule.static_senders(cycle.cycle).index(node)
            return self._box(place, place + 1, y)
        rows = len(self._stage.plan.schedule.static_table)
        owned = [s.frame_id for s in table.static_slots(cycle.cycle % rows) if s.node == node]
        start = cluster.slot_start_us(min(owned))
        return self._box(start, cluster.slot_start_us(max(owned)) + cluster.static_slot_us, y)

    def _box(self, start_us: float, end_us: float, y: float) -> str:
        x = self._x(start_us)
        wide = max(self._x(end_us) - x - 0.7, 0.5)
        return f"M{x:.1f} {y:g}h{wide:.1f}v{ROW - 2:g}h-{wide:.1f}z"

    def _legend(self, theme: Theme, cycle: BusCycle) -> str:
        entries = [
            (theme.seeing, "static frame"),
            (theme.sending, "sending"),
            (theme.estimate, "dynamic frame"),
            (theme.down, "silent or not received"),
        ]
        spans = "".join(
            f'<span style="margin-right:14px;white-space:nowrap"><span style="display:inline-block;'
            f'width:9px;height:9px;margin-right:5px;border-radius:2px;background:{css(colour)}">'
            f"</span>{text}</span>"
            for colour, text in entries
        )
        cluster, facts = self._stage.cluster, "a bus without time"
        if cluster is not None:
            load = 100 * bus_load(cluster, cycle.frames)
            facts = (
                f"{escape(cluster.name)}: cycle {cluster.cycle_us / 1e3:.4g} ms, "
                f"{len(cycle.frames)} frames, load {load:.0f} %"
            )
        return (
            f'<div style="display:flex;justify-content:space-between;flex-wrap:wrap;font-size:11px;'
            f'color:{css(theme.quiet)};padding:2px 4px"><span>{spans}</span>'
            f'<span data-testid="bus-load">{facts}</span></div>'
        )


_INK = {"past": (20, 30, 40), "now": (20, 30, 40), "future": (120, 126, 138)}


def _room(text: str) -> float:
    """Pixels that a text takes."""
    return 6.0 * len(text) + 3


def _short(name: str) -> str:
    return name if len(name) <= 3 else name[:3]
