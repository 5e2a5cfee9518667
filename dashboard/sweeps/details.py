"""The cells of a sweep as a table, and the runs and errors of one of them, as HTML."""

from html import escape

import numpy as np

from concord.dashboard.digits import rounded
from concord.dashboard.panels.chart import Curve, Drawn
from concord.dashboard.panels.shared_run import chart_svg
from concord.dashboard.sweeps.swept import Choices, SweptCells, looks, shown_cells, worded
from concord.dashboard.theme import css

MOST_ROWS = 200
_WIDTH, _HEIGHT, _LEFT = 380.0, 74.0, 14.0


def cell_table(swept: SweptCells, choices: Choices) -> str:
    """Return the shown cells, the least value of the upright axis first.

    A row has the number of its cell; its button has that number plus the count of cells.
    """
    theme, shown = choices.theme, shown_cells(swept, choices)
    columns = [one for one in swept.quantities if one.name in (choices.up, choices.across)]
    columns = sorted(columns, key=lambda one: one.name != choices.up)
    order = np.flatnonzero(shown)
    if columns:
        order = order[np.argsort(columns[0].intervals[order, 0], kind="stable")]
    look, quiet = looks(swept, choices), css(theme.quiet)
    heads = "".join(
        f"<th>{escape(name)}</th>" for name in (*swept.fields, *(c.name for c in columns))
    )
    rows = []
    for cell in order[:MOST_ROWS].tolist():
        marked = cell in (choices.selected, choices.hovered)
        values = "".join(f"<td>{escape(worded(of[cell]))}</td>" for of in swept.fields.values())
        values += "".join(f"<td>{_with_half(one.intervals[cell])}</td>" for one in columns)
        background = f"background:{css(theme.edge, 0.4)}" if marked else ""
        glyph, colour = look[cell]
        rows.append(
            f'<tr data-node="{cell}" style="cursor:pointer;{background}">'
            f'<td style="color:{css(colour)}">{glyph}</td>{values}<td data-node='
            f'"{cell + len(look)}" title="compute the middle run of this cell and open its page" '
            f'style="color:{css(theme.seeing)}">▶</td></tr>'
        )
    left = len(order) - MOST_ROWS
    more = f"{left} more cells have larger values; choose fewer at the left" if left > 0 else ""
    return (
        f'<div style="font-size:11.5px;padding:4px 8px;color:{css(theme.text)}">'
        '<table data-testid="cell-table" data-marks="table of cells" style="width:100%;'
        'text-align:right;border-collapse:collapse;font-variant-numeric:tabular-nums" '
        'cellpadding="3">'
        f'<tr style="color:{quiet}"><th></th>{heads}<th>run</th></tr>{"".join(rows)}</table>'
        f'<div style="color:{quiet}">{more}</div></div>'
    )


def runs_panel(swept: SweptCells, choices: Choices) -> str:
    """Return the runs of a cell along their RMSE; each has its place as number."""
    theme, cell = choices.theme, choices.selected
    if cell is None:
        return _said(choices, "press a cell to see its runs")
    head = f"<b>{escape(swept.words(cell))}</b>"
    rmse = swept.rmse[cell]
    known = np.isfinite(rmse)
    if not known.any():
        return _said(choices, f"{head}<br>the sweep kept no single runs; ▶ opens its first one")
    low, high = float(np.nanmin(rmse)), float(np.nanmax(rmse))
    span = (high - low) or 1.0
    median = float(np.nanmedian(rmse))
    places = _LEFT + (_WIDTH - 2 * _LEFT) * (rmse - low) / span
    at = _LEFT + (_WIDTH - 2 * _LEFT) * (median - low) / span
    dots = []
    # Runs of nearly one RMSE are drawn above each other.
    used: dict[int, int] = {}
    for place in np.argsort(rmse)[: known.sum()].tolist():
        x = places[place]
        row = used[int(x / 11)] = used.get(int(x / 11), -1) + 1
        dots.append(
            f'<circle data-node="{place}" cx="{x:.1f}" cy="{46 - 11 * (row % 4):g}" r="5" '
            f'fill="{css(theme.estimate)}" style="cursor:pointer"><title>run '
            f"{swept.runs[place]}: RMSE {rounded(rmse[place], 4)} {escape(swept.unit)}; "
            "press to open its page</title></circle>"
        )
    quiet = css(theme.quiet)
    unit = "" if swept.unit == "1" else f" {escape(swept.unit)}"
    words = "".join(
        f'<text x="{x:g}" y="70" font-size="11" fill="{quiet}" text-anchor="{anchor}">'
        f"{rounded(value, 4)}{unit}</text>"
        for x, anchor, value in ((_LEFT - 8, "start", low), (_WIDTH - _LEFT + 8, "end", high))
    )
    return _said(
        choices,
        f"{head}<br>RMSE of its {known.sum()} runs, line: median; press a run to open its page"
        '<svg data-testid="runs" data-marks="runs of the cell" width="100%" '
        f'viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}">'
        f'<path d="M{_LEFT:g} 56H{_WIDTH - _LEFT:g}M{at:.1f} 6V56" stroke="{quiet}"/>'
        f"{words}{''.join(dots)}</svg>",
    )


def error_panel(swept: SweptCells, choices: Choices) -> str:
    """Return RMSE over time of the selected cell, and of the hovered one beside it."""
    theme, cell = choices.theme, choices.selected
    cell = choices.hovered if cell is None else cell
    if cell is None:
        return ""
    colours = (theme.estimate, theme.fused, theme.quiet)
    curves = [
        Curve(name, colour, name != "nodes", values[cell])
        for (name, values), colour in zip(swept.errors.items(), colours, strict=True)
    ]
    if choices.hovered not in (None, cell):
        other = swept.errors["nodes"][choices.hovered]
        curves.append(Curve("pointed at", theme.seeing, False, other))
    unit = "" if swept.unit == "1" else f" [{swept.unit}]"
    known = [curve.values[np.isfinite(curve.values)] for curve in curves]
    if not any(map(len, known)):
        return _said(choices, "the sweep kept no errors over time")
    is_logarithmic = all((values > 0).all() for values in known)
    chart = Drawn(f"RMSE over runs{unit}", swept.times, tuple(curves), is_logarithmic)
    return f'<div data-testid="errors" style="padding:2px 6px">{chart_svg(theme, chart)}</div>'


def _said(choices: Choices, html: str) -> str:
    colour = css(choices.theme.text)
    return f'<div style="font-size:12px;padding:4px 10px;color:{colour}">{html}</div>'


def _with_half(interval: np.ndarray) -> str:
    value, low, high = interval
    if not np.isfinite(value):
        return "-"
    half = (high - low) / 2
    return rounded(value, 4) + (f" ±{half:.2g}" if np.isfinite(half) and half else "")
