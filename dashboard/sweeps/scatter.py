"""The cells of a sweep in a plane of two figures or fields, with their intervals, as SVG."""

from collections.abc import Callable
from html import escape
from typing import NamedTuple

import numpy as np

from concord.dashboard.digits import rounded
from concord.dashboard.sweeps.swept import (
    Choices,
    SweptCells,
    is_number,
    looks,
    shown_cells,
    worded,
)
from concord.dashboard.theme import Theme, css

_LEFT, _BOTTOM, _TOP, _RIGHT = 66.0, 52.0, 26.0, 22.0
# An axis is logarithmic where its largest value is so many times its least.
_WIDE = 20.0


class _Axis(NamedTuple):
    """Places of cells on an axis, in its own units: `values` (C, 3), and the marks below it."""

    name: str
    values: np.ndarray
    ticks: list[tuple[float, str]]
    reference: float | None
    place: Callable[[np.ndarray], np.ndarray]


def scatter(swept: SweptCells, choices: Choices) -> str:
    """Return the picture; cells outside of the limits are faint, and cannot be pressed."""
    theme, shown = choices.theme, shown_cells(swept, choices)
    across, up = (_axis(swept, name, shown) for name in (choices.across, choices.up))
    right, bottom = choices.width - _RIGHT, choices.height - _BOTTOM
    x = _LEFT + (right - _LEFT) * across.place(across.values)
    y = bottom - (bottom - _TOP) * up.place(up.values)
    look = looks(swept, choices)
    marks = []
    # The hovered and the selected cell lie above the others.
    first = sorted(
        range(len(x)), key=lambda c: (shown[c], c in (choices.selected, choices.hovered))
    )
    for cell in first:
        a, b = x[cell, 0], y[cell, 0]
        if not np.isfinite([a, b]).all():
            continue
        glyph, colour = look[cell]
        if not shown[cell]:
            marks.append(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{css(theme.faint)}"/>')
            continue
        ring = ""
        if cell in (choices.selected, choices.hovered):
            dash = "" if cell == choices.selected else ' stroke-dasharray="3 3"'
            ring = (
                f'<circle cx="{a:.1f}" cy="{b:.1f}" r="14" fill="none" stroke="'
                f'{css(theme.selection)}" stroke-width="2"{dash}/>'
            )
        marks.append(
            f'<g data-node="{cell}" style="cursor:pointer"><title>{escape(swept.words(cell))}'
            f"</title>{_bars(x[cell], y[cell], css(colour, 0.55))}{ring}"
            f'<circle cx="{a:.1f}" cy="{b:.1f}" r="13" fill="transparent"/>'
            f'<text x="{a:.1f}" y="{b:.1f}" font-size="18" text-anchor="middle" '
            f'dominant-baseline="central" fill="{css(colour)}">{glyph}</text></g>'
        )
    return (
        f'<svg data-testid="cells" data-marks="cells" width="100%" '
        f'viewBox="0 0 {choices.width:g} {choices.height:g}" '
        f'style="display:block;max-height:calc(100vh - 120px)" font-family="sans-serif">'
        f"{_frame(theme, across, up, right, bottom)}{''.join(marks)}</svg>{_legend(swept, choices)}"
    )


def axes_of(swept: SweptCells) -> tuple[str, ...]:
    """Return the names that an axis can have: figures, then fields."""
    return (*(one.name for one in swept.quantities), *swept.fields)


def _axis(swept: SweptCells, name: str, shown: np.ndarray) -> _Axis:
    """Return an axis that holds all shown cells."""
    reference = None
    if name in swept.fields:
        of, levels = swept.fields[name], swept.levels(name)
        if not all(map(is_number, levels)):
            single = np.array([levels.index(value) for value in of], dtype=np.float64)
            ticks = [(float(at), worded(level)) for at, level in enumerate(levels)]
            return _Axis(name, _repeated(single), ticks, None, _straight(-0.5, len(levels) - 0.5))
        values = _repeated(np.array(of, dtype=np.float64))
    else:
        quantity = next(one for one in swept.quantities if one.name == name)
        values, reference = quantity.intervals, quantity.reference
    known = values[shown][np.isfinite(values[shown])]
    known = known if len(known) else np.array([0.0, 1.0])
    low, high = float(known.min()), float(known.max())
    if reference is not None:
        low, high = min(low, reference), max(high, reference)
    if low > 0 and high > _WIDE * low:
        ends = np.log10([low, high]) + np.array([-0.06, 0.06])
        decades = range(int(np.floor(ends[0])), int(np.ceil(ends[1])) + 1)
        steps = (1, 2, 5) if ends[1] - ends[0] < 3 else (1,)
        round_values = [step * 10.0**decade for decade in decades for step in steps]
        inside = [(v, rounded(v)) for v in round_values if ends[0] <= np.log10(v) <= ends[1]]
        straight = _straight(*ends)
        return _Axis(
            name, values, inside, reference,
            lambda v: straight(np.log10(np.where(v > 0, v, np.nan))),
        )  # fmt: skip
    margin = 0.07 * ((high - low) or abs(high) or 1.0)
    low, high = (0.0 if 0 <= low < 0.3 * high else low - margin), high + margin
    step = 10.0 ** np.floor(np.log10((high - low) / 4))
    step *= next(by for by in (5, 2, 1) if by == 1 or (high - low) / (by * step) >= 4)
    ticks = [(v, rounded(v, 5)) for v in step * np.arange(np.ceil(low / step), high / step)]
    return _Axis(name, values, ticks, reference, _straight(low, high))


def _repeated(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[:, None], 3, axis=1)


def _straight(low: float, high: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: (np.asarray(values) - low) / (high - low)


def _bars(x: np.ndarray, y: np.ndarray, colour: str) -> str:
    """Return the intervals of a cell, both axes, where they are known."""
    paths = []
    if np.isfinite(y).all():
        paths.append(f"M{x[0]:.1f} {y[1]:.1f}V{y[2]:.1f}")
    if np.isfinite(x).all():
        paths.append(f"M{x[1]:.1f} {y[0]:.1f}H{x[2]:.1f}")
    return f'<path d="{"".join(paths)}" stroke="{colour}" stroke-width="1.5"/>'


def _frame(theme: Theme, across: _Axis, up: _Axis, right: float, bottom: float) -> str:
    """Return grid, numbers, names and reference lines of both axes, which end at these edges."""
    grid, words = [], []
    for value, text in across.ticks:
        x = _LEFT + (right - _LEFT) * float(across.place(np.array(value)))
        grid.append(f"M{x:.1f} {_TOP:g}V{bottom:g}")
        words.append(_word(theme, x, bottom + 18, "middle", text))
    for value, text in up.ticks:
        y = bottom - (bottom - _TOP) * float(up.place(np.array(value)))
        grid.append(f"M{_LEFT:g} {y:.1f}H{right:g}")
        words.append(_word(theme, _LEFT - 7, y + 4, "end", text))
    special = []
    if across.reference is not None:
        x = _LEFT + (right - _LEFT) * float(across.place(np.array(across.reference)))
        special.append(f"M{x:.1f} {_TOP:g}V{bottom:g}")
    if up.reference is not None:
        y = bottom - (bottom - _TOP) * float(up.place(np.array(up.reference)))
        special.append(f"M{_LEFT:g} {y:.1f}H{right:g}")
    words.append(_word(theme, (_LEFT + right) / 2, bottom + 42, "middle", across.name, strong=True))
    words.append(_word(theme, 6, 16, "start", up.name, strong=True))
    return (
        f'<path d="{"".join(grid)}" stroke="{css(theme.faint)}"/><path d="{"".join(special)}" '
        f'stroke="{css(theme.quiet)}" stroke-dasharray="6 4"/>{"".join(words)}'
    )


def _word(theme: Theme, x: float, y: float, anchor: str, text: str, strong: bool = False) -> str:
    colour = css(theme.text if strong else theme.quiet)
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{14 if strong else 13}" fill="{colour}" '
        f'text-anchor="{anchor}">{escape(text)}</text>'
    )


def _legend(swept: SweptCells, choices: Choices) -> str:
    """Return the signs of the coloured field, and what the bars are."""
    theme, look, words = choices.theme, looks(swept, choices), ""
    if choices.colour in swept.fields and len(set(look)) > 1:
        seen = dict(zip(swept.fields[choices.colour], look, strict=True))
        words = f"{escape(choices.colour)}: " + " ".join(
            f'<span style="color:{css(seen[level][1])}">{seen[level][0]} </span>'
            f"{escape(worded(level))}&ensp;"
            for level in swept.levels(choices.colour)
        )
    return (
        f'<div style="font-size:12px;padding:2px 12px;color:{css(theme.quiet)}">{words} bars: 95 % '
        "interval over runs; press a sign to see its runs</div>"
    )
