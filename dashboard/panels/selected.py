"""The selected node in detail: what it believes of every state, whom it hears and how freshly."""

from html import escape

import numpy as np

from concord.dashboard.frames.conditions import conditions
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.theme import css
from concord.dashboard.view import View


def selected_panel(stage: Stage, view: View, frame: StepFrame) -> str:
    """HTML; asks for a selection where there is none."""
    theme, node = view.theme, view.selected
    if node is None:
        return (
            f'<div style="font-size:12px;padding:4px 10px;color:{css(theme.quiet)}">'
            "click a node in the scene, in the table or on the bus</div>"
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
    heard = []
    for position in np.flatnonzero(stage.heard[:, 0] == node):
        sender, age = int(stage.heard[position, 1]), int(frame.ages[position])
        lost = frame.lost[position]
        when = "never" if age < 0 else f"{age} cycles"
        colour = css(theme.down if lost else theme.text)
        heard.append(
            f'<span style="color:{colour};margin-right:10px;white-space:nowrap">'
            f"{escape(stage.names[sender])}: {when}{' (newest lost)' if lost else ''}</span>"
        )
    word = conditions(stage, frame)[node]
    spread = "set" if stage.set_valued else "3σ"
    return (
        '<div data-testid="selected" style="font-size:12px;padding:4px 10px;color:'
        f'{css(theme.text)}"><b>node {escape(stage.names[node])}</b> is {word}'
        f'<table style="width:100%;text-align:right;'
        f'margin:6px 0;font-variant-numeric:tabular-nums"><tr style="color:{css(theme.quiet)}">'
        f"<th>state</th><th>estimate</th><th>{spread}</th><th>error</th>"
        f'<th></th></tr>{"".join(rows)}</table><div style="color:{css(theme.quiet)}">age of what '
        f"it holds</div>{''.join(heard)}</div>"
    )
