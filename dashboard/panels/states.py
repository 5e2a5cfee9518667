"""All states over the last while, one below the other: truth, estimate, its deviations."""

from collections.abc import Sequence
from html import escape

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.history import FrameHistory, state_table
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.chart import known_pieces
from concord.dashboard.theme import Theme, css
from concord.dashboard.view import View

MOST_STEPS, MOST_POINTS = 400, 130
WIDTH, HEIGHT, HEAD, FOOT = 300.0, 290.0, 14.0, 4.0
_LEAST, _MOST = 52.0, 110.0


def states(stage: Stage, view: View, history: FrameHistory) -> str:
    """An SVG with a row per state, of the selected node, the first where none is."""
    theme, node = view.theme, view.selected or 0
    count = len(stage.state_names)
    row = min(max(HEIGHT / count, _LEAST), _MOST)
    frames = history.sampled(view.step, MOST_POINTS, MOST_STEPS)
    rows = "".join(_row(stage, view, frames, node, state, row) for state in range(count))
    legend = [(theme.truth, "truth"), (theme.estimate, f"node {escape(stage.names[node])}")]
    marks = "".join(
        f'<span style="margin-right:9px"><span style="color:{css(colour)}">●</span> {text}</span>'
        for colour, text in legend
    )
    width = "its set" if stage.set_valued else f"±{stage.deviations:g}σ"
    return (
        f'<div style="font-size:11px;padding-right:8px;color:{css(theme.text)}">'
        '<svg data-testid="states" '
        f'viewBox="0 0 {WIDTH:g} {row * count:g}" width="100%" style="display:block">{rows}</svg>'
        f'<div style="padding:2px 4px">{marks} {width}</div></div>'
    )


def _row(
    stage: Stage, view: View, frames: Sequence[StepFrame], node: int, state: int, tall: float
) -> str:
    theme, top = view.theme, tall * state
    times = np.array([frame.time_s for frame in frames])
    truth, mean, deviation = state_table(frames, node, state).T
    reach = np.array([frame.stage.deviations for frame in frames]) * deviation
    lines = np.stack([truth, mean, mean + reach, mean - reach])
    known = lines[np.isfinite(lines)]
    head = _head(theme, top, tall, stage.state_names[state], stage.state_units[state])
    if len(times) < 2 or not len(known):
        return head
    low, high = float(known.min()), float(known.max())
    x = (times - times[0]) / (times[-1] - times[0]) * WIDTH
    y = top + HEAD + (high - lines) / ((high - low) or 1.0) * (tall - HEAD - FOOT)
    around = "".join(
        f'<polygon points="{_points(np.r_[x[s], x[s][::-1]], np.r_[y[2][s], y[3][s][::-1]])}" '
        f'fill="{css(theme.estimate, 0.28)}"/>'
        for s in known_pieces(y[2] + y[3])
    )
    drawn = "".join(
        f'<polyline points="{_points(x[s], row[s])}" fill="none" stroke="{css(colour)}" '
        f'stroke-width="1.6"/>'
        for row, colour in ((y[0], theme.truth), (y[1], theme.estimate))
        for s in known_pieces(row)
    )
    ends = f"{low:.3g} to {high:.3g}"
    return (
        f'{head}<text x="{WIDTH - 2:g}" y="{top + 10:g}" font-size="10" text-anchor="end" '
        f'fill="{css(theme.quiet)}">{ends}</text>'
        f"{around}{drawn}"
    )


def _head(theme: Theme, top: float, tall: float, name: str, unit: str) -> str:
    of = "" if unit == "1" else f" [{unit}]"
    return (
        f'<text x="2" y="{top + 10:g}" font-size="10.5" fill="{css(theme.text)}">'
        f'{escape(name + of)}</text><path d="M0 {top + tall - 1:g}H{WIDTH:g}" '
        f'stroke="{css(theme.faint)}"/>'
    )


def _points(x: np.ndarray, y: np.ndarray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
