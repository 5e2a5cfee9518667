"""The selected node in detail: its belief of each state, and the shares that made it."""

from collections.abc import Sequence
from html import escape

import numpy as np

from concord.dashboard.explain.explanation import explanation
from concord.dashboard.frames.conditions import conditions
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.theme import css
from concord.dashboard.view import View

_HEADINGS = {
    "state": "state of the plant",
    "estimate": "mean of the belief of the node",
    "3σ": "three standard deviations as the node believes, or the half-width of its set",
    "error": "estimate less truth; red where it is larger than the node believes",
    "unit": "unit of the state",
}


def selected_panel(stage: Stage, view: View, past: Sequence[StepFrame]) -> str:
    """Return the belief of the selected node in the last of these frames, and what made it."""
    theme, node, frame = view.theme, view.selected, past[-1]
    if node is None:
        return (
            f'<div style="font-size:12px;padding:4px 10px;color:{css(theme.quiet)}">'
            "click a node in the scene or on the bus, or a number in the table</div>"
        )
    rows = []
    for index, (name, unit) in enumerate(zip(stage.state_names, stage.state_units, strict=True)):
        mean, variance = frame.belief.mean[node, index], frame.belief.cov[node, index, index]
        wide = stage.deviations * np.sqrt(max(float(variance), 0.0))
        off = mean - frame.truth[index]
        bad = np.isfinite(off) and abs(off) > wide
        colour = css(theme.down if bad else theme.text)
        rows.append(
            f"<tr><td>{escape(name)}</td><td>{mean:.5g}</td><td>±{wide:.3g}</td>"
            f'<td style="color:{colour}">{off:+.3g}</td><td>{escape(unit)}</td></tr>'
        )
    word = conditions(frame)[node]
    spread = "set" if stage.set_valued else "3σ"
    heads = "".join(
        f'<th title="{meaning}">{spread if head == "3σ" else head}</th>'
        for head, meaning in _HEADINGS.items()
    )
    return (
        '<div data-testid="selected" style="font-size:12px;padding:4px 10px;color:'
        f'{css(theme.text)}"><b>node {escape(stage.names[node])}</b> is {word}'
        f'<table style="width:100%;text-align:right;'
        f'margin:6px 0;font-variant-numeric:tabular-nums"><tr style="color:{css(theme.quiet)}">'
        f"{heads}</tr>{''.join(rows)}</table>{explanation(theme, past, node)}</div>"
    )
