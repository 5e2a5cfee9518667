"""Marks of the bus timeline: slots, silent slots, names and the legend, as SVG text."""

from collections.abc import Sequence
from html import escape
from itertools import groupby
from typing import NamedTuple

from concord.bus.bus import Transmission
from concord.dashboard.frames.frame import BusCycle
from concord.dashboard.theme import Theme, css, mixed

WIDTH, LEFT, RIGHT = 1000.0, 62.0, 8.0
TOP, BAR, ROW = 20.0, 34.0, 9.0
NUMBERS_END = LEFT - 6.0
"""Where the numbers of cycles end, left of the slots."""
_DIGIT = 0.66  # width of a digit, of the size of its letters


# Widths of a panel below which the letters of a drawing grow, in pixels; their size in it, the room
# for a text beside its usual room, and the class of texts that have less.
_NARROW = ((800, 14, 1.4, "crowded"), (560, 20, 2.0, "wide"))


def readable(drawing: str) -> str:
    """Return a drawing of `WIDTH` whose letters can be read in a narrow panel too."""
    rules = "".join(
        f"@container (max-width:{most_px}px){{.drawing text{{font-size:{size}px}}"
        f".drawing .number{{font-size:min({size}px,var(--most))}}"
        f".drawing .{left_out}{{display:none}}}}"
        for most_px, size, _, left_out in _NARROW
    )
    return (
        f'<div class="drawing" style="container-type:inline-size"><style>{rules}</style>'
        f"{drawing}</div>"
    )


def number(cycle: int, y: float, colour: str, attributes: str = "") -> str:
    """Return the number of a cycle; growing letters stay between the edge and the slots."""
    most_px = NUMBERS_END / (_DIGIT * len(str(cycle)))
    return (
        f'<text class="number" x="{NUMBERS_END:g}" y="{y:g}" font-size="11" text-anchor="end" '
        f'style="--most:{most_px:.1f}px" fill="{colour}" {attributes}>{cycle}</text>'
    )


class Axis(NamedTuple):
    """The time of a cycle from left to right."""

    span_us: float

    def x(self, time_us: float) -> float:
        """Return the place of a time, in units of the drawing."""
        return LEFT + (WIDTH - LEFT - RIGHT) * time_us / self.span_us

    def box(self, start_us: float, end_us: float, y: float) -> str:
        """Return the path of a box in a row of the raster."""
        x = self.x(start_us)
        wide = max(self.x(end_us) - x - 0.7, 0.5)
        return f"M{x:.1f} {y:g}h{wide:.1f}v{ROW - 2:g}h-{wide:.1f}z"


def names_of_trains(axis: Axis, theme: Theme, names: Sequence[str], cycle: BusCycle) -> str:
    """Return the names of nodes that send many frames in a row, each too short for a name."""
    text = []
    for node, frames in groupby(cycle.frames, key=lambda frame: frame.node):
        train, name = list(frames), names[node]
        x, right = axis.x(train[0].start_us), axis.x(train[-1].end_us)
        single = axis.x(train[0].end_us) - x
        if len(train) > 1 and single < _room(_short(name)) and right - x > _room(name):
            text.append(
                f'<text{_if_wide(name, right - x)} x="{(x + right) / 2:.1f}" '
                f'y="{TOP + BAR / 2 + 4:g}" font-size="11" '
                f'text-anchor="middle" fill="{css(theme.text)}" stroke="{css(theme.panel)}" '
                f'stroke-width="3" paint-order="stroke" pointer-events="none">'
                f"{escape(name)}</text>"
            )
    return "".join(text)


def slot(
    axis: Axis, theme: Theme, name: str, frame: Transmission, state: str, is_selected: bool,
    is_lost: bool, channels: str,
) -> str:  # fmt: skip
    """Return the box of a frame; `state` is past, now or future. A frame on one of two `channels`
    has the upper or the lower half of the bar."""
    x, right = axis.x(frame.start_us), axis.x(frame.end_us)
    top, high = _lane(frame.channel, channels)
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
        letters = theme.panel if state != "future" else theme.text
        text = (
            f'<text{_if_wide(_short(name), wide)} x="{x + wide / 2:.1f}" '
            f'y="{top + high / 2 + 4:g}" font-size="{size}" '
            f'text-anchor="middle" fill="{css(letters if theme.dark else _INK)}">'
            f"{escape(_short(name))}</text>"
        )
    mark = ""
    if is_lost:
        mark = (
            f'<rect x="{x:.1f}" y="{top + high - 3:g}" width="{wide:.1f}" height="5" '
            f'fill="{css(theme.down)}"/>'
        )
    return (
        f'<g class="slot" data-node="{frame.node}"><title>node {escape(name)}: frame '
        f"{frame.frame_id}, channel {frame.channel}, {frame.payload_bytes} bytes, "
        f"{frame.start_us:.1f} to {frame.end_us:.1f} us{note}</title>"
        f'<rect x="{x:.1f}" y="{top:g}" width="{wide:.1f}" height="{high:g}" rx="1.5" '
        f'fill="{css(shown)}"{stroke}/>{text}{mark}</g>'
    )


def _lane(channel: str, channels: str) -> tuple[float, float]:
    """Return top and height of a frame in the bar of a bus with these channels."""
    whole = BAR - 4
    if len(channel) != 1 or len(channels) < 2:
        return TOP + 2, whole
    return TOP + 2 + channels.index(channel) * whole / 2, whole / 2 - 1


def silent_slot(
    axis: Axis, theme: Theme, name: str, node: int, span_us: tuple[float, float]
) -> str:
    """Return the mark of an owner that sent nothing: an empty frame with a cross."""
    start_us, end_us = span_us
    x, wide = axis.x(start_us), axis.x(end_us) - axis.x(start_us)
    middle, y = x + wide / 2, TOP + BAR / 2
    arm = min(4.0, wide / 3)
    return (
        f'<g class="slot" data-node="{node}"><title>node {escape(name)}: silent</title>'
        f'<rect x="{x + 1:.1f}" y="{TOP + 3:g}" width="{max(wide - 2, 0.8):.1f}" '
        f'height="{BAR - 6:g}" fill="{css(theme.panel)}" stroke="{css(theme.down)}" '
        f'stroke-width="1.5"/><path d="M{middle - arm:.1f} {y - arm:g}l{2 * arm:.1f} '
        f'{2 * arm:.1f}m0 {-2 * arm:.1f}l{-2 * arm:.1f} {2 * arm:.1f}" '
        f'stroke="{css(theme.down)}" stroke-width="1.5"/></g>'
    )


def missed_and_rejected(axis: Axis, theme: Theme, cycle: BusCycle, y: float) -> str:
    """Return the marks of a past cycle: below frames that were missed, beside it of rejections."""
    path = ""
    for frame in cycle.frames:
        if frame.node in cycle.missed:
            x = axis.x(frame.start_us)
            wide = max(axis.x(frame.end_us) - x - 0.7, 0.5)
            path += f"M{x:.1f} {y + ROW - 4.5:g}h{wide:.1f}v2.5h-{wide:.1f}z"
    marks = f'<path class="missed" d="{path}" fill="{css(theme.down)}"/>' if path else ""
    if cycle.rejected:
        x, middle = WIDTH - RIGHT + 4, y + ROW / 2 - 1
        marks += (
            f'<path class="rejected" d="M{x - 4:g} {middle:g}l4 -4l4 4l-4 4z" '
            f'fill="{css(theme.estimate)}"><title>{escape("; ".join(cycle.rejected))}</title>'
            "</path>"
        )
    return marks


def legend(theme: Theme, cycle: BusCycle, step: Sequence[BusCycle]) -> str:
    """Return the colours with their meaning, and the facts of the shown cycle and of its step."""
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
    bus, facts = cycle.bus, "a bus without time"
    if bus.has_time:
        load = 100 * bus.load(cycle.frames)
        in_step = sum(bus.load(one.frames) for one in step)
        over_all = 100 * in_step / bus.timebase.cycles_of(1)
        facts = (
            f"{escape(bus.name)}: cycle {bus.cycle_us / 1e3:.4g} ms, "
            f"{len(cycle.frames)} frames, load {load:.0f} % ({over_all:.2g} % of all)"
        )
    return (
        '<div class="bus-legend" style="display:flex;justify-content:space-between;'
        f'flex-wrap:wrap;font-size:11px;color:{css(theme.quiet)};padding:2px 4px">'
        f'<span>{spans}</span><span data-testid="bus-load">{facts}</span></div>'
    )


_INK = (20, 30, 40)


def _room(text: str) -> float:
    """Pixels that a text takes."""
    return 6.0 * len(text) + 3


def _if_wide(text: str, wide: float) -> str:
    """Return the classes of a text in a box, for which narrow panels have no room."""
    classes = [name for *_, times, name in _NARROW if wide < times * _room(text)]
    return f' class="{" ".join(classes)}"' if classes else ""


def _short(name: str) -> str:
    return name if len(name) <= 3 else name[:3]
