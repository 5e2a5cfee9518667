"""The explanation of an estimate: its shares, with slot, age and weight, as HTML."""

from collections.abc import Sequence
from html import escape

import numpy as np

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.provenance import ShareArrival, UsedShare, provenance
from concord.dashboard.theme import Theme, css, ink

HEADINGS = {
    "from": "sender of the share; own: the node's own belief",
    "weight": "part of the share in the average of the last round, as the node told it",
    "age": "cycles from the sending of the share to the end of the step",
    "sent": "step and cycle of the bus in which the share was sent",
    "slot": "frame ID, and the time within the cycle",
    "": "how the share came to the node",
}
"""Headings of the table of shares, with their meaning."""


def explanation(theme: Theme, past: Sequence[StepFrame], node: int) -> str:
    """Return the shares that made a node's estimate in the last of these frames."""
    frame = past[-1]
    stage, quiet = frame.stage, css(theme.quiet)
    if not frame.alive[node]:
        return f'<div style="color:{quiet}">The node is down: it made no estimate.</div>'
    made = provenance(past, node)
    top = max([made.own_weight, *(share.weight for share in made.shares)])
    rows = [_row(theme, "own", made.own_weight, top, ("", "", "", _own_reading(frame, node)))]
    for share in sorted(made.shares, key=_by_weight):
        name, is_bad = escape(stage.names[share.sender]), share.arrival is not ShareArrival.FRESH
        rows.append(_row(theme, name, share.weight, top, _places(share), share.sender, is_bad))
    heads = "".join(f'<th title="{meaning}">{head}</th>' for head, meaning in HEADINGS.items())
    note = ""
    if np.isnan(made.own_weight) and made.shares:
        rule = escape(stage.setup.scenario.rule.name)
        note = f'<div style="color:{quiet}">The rule {rule} tells no weights.</div>'
    return (
        f'<div style="color:{quiet};margin-top:4px">shares that made this estimate in step '
        f'{frame.step}</div><table data-testid="explanation" style="width:100%;text-align:right;'
        f'white-space:nowrap;font-size:11px;font-variant-numeric:tabular-nums">'
        f'<tr style="color:{quiet}">{heads}'
        f"</tr>{''.join(rows)}</table>{note}"
    )


def _by_weight(share: UsedShare) -> tuple[float, int]:
    return -np.nan_to_num(share.weight), share.sender


def _own_reading(frame: StepFrame, node: int) -> str:
    if not frame.seen[node]:
        return "no reading"
    nis = float("nan") if frame.scores.nis is None else frame.scores.nis.of(node)
    return "own reading" + (f", NIS {nis:.2g}" if np.isfinite(nis) else "")


def _places(share: UsedShare) -> tuple[str, str, str, str]:
    """Return age, step and cycle, slot, and the words of a share."""
    age = "-" if share.age_cycles < 0 else str(share.age_cycles)
    if share.step is None:
        return age, "-", "-", share.arrival.value
    slots = ", ".join(f"{one.frame_id} ({one.start_us / 1e3:.3g} ms)" for one in share.frames[:3])
    more = f" and {len(share.frames) - 3} more" if len(share.frames) > 3 else ""
    return age, f"{share.step}, {share.bus_cycle}", slots + more, share.arrival.value


def _row(
    theme: Theme, name: str, weight: float, top: float, places: tuple[str, str, str, str],
    sender: int | None = None, is_bad: bool = False,
) -> str:  # fmt: skip
    age, sent, slot, how = places
    bar = 0.0 if not top > 0 or np.isnan(weight) else 100 * weight / top
    fill = f"linear-gradient(to right,{css(theme.fused, 0.35)} {bar:.0f}%,transparent {bar:.0f}%)"
    told = "-" if np.isnan(weight) else f"{weight:.2f}"
    colour = f' style="color:{ink(theme, theme.down)}"' if is_bad else ""
    owner = "" if sender is None else f' data-sender="{sender}"'
    return (
        f'<tr{owner}><td>{name}</td><td style="background:{fill}">{told}</td><td>{age}</td>'
        f"<td>{sent}</td><td>{slot}</td>"
        f'<td style="text-align:left;padding-left:6px"><span{colour}>{how}</span></td></tr>'
    )
