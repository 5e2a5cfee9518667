"""The table of nodes, the log and the state of the run, as HTML; all text from outside escaped."""

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from concord.dashboard.digits import rounded
from concord.dashboard.explain.help import HEADINGS
from concord.dashboard.explain.tooltips import chart_meanings
from concord.dashboard.frames.conditions import BLIND, DOWN, REJECTED, conditions, oldest
from concord.dashboard.frames.frame import LogEntry, StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.frames.verdict import RunVerdict, health
from concord.dashboard.panels.charts import powered, shown_power
from concord.dashboard.scene.signs import MARKS, colour_of
from concord.dashboard.theme import Theme, css, ink, letters_on
from concord.dashboard.view import View

MOST_ROWS = 60
_HEADINGS = ("node", "state", "sent", "miss", "rej", "age", "error", "3σ", "rejected")
_SCALED = ("error", "3σ", "set")


def node_table(stage: Stage, view: View, frame: StepFrame) -> str:
    """A row per node."""
    theme, words, ages = view.theme, conditions(frame), oldest(frame)
    width = frame.scores.width if stage.set_valued else 3.0 * largest_deviation(frame)
    rows = chosen_rows(stage.nodes, view, frame.scores.error, ages)
    told = any(frame.rejection)
    top = float(np.nanmax(width)) if np.isfinite(width).any() else 1.0
    # Small numbers in full would push the last column out of a narrow window.
    power = shown_power([np.nan_to_num(frame.scores.error), np.nan_to_num(width)])
    share = 10.0**-power
    cells = []
    for node in rows:
        colour = theme.quiet if words[node] == BLIND else colour_of(theme, words[node])
        marked = f"background:{css(theme.faint)};" if node == view.selected else ""
        if node == view.hovered and node != view.selected:
            marked = f"background:{css(theme.faint, 0.5)};"
        error = frame.scores.error[node]
        bar = min(100.0, 100.0 * error / top) if np.isfinite(error) and top > 0 else 0.0
        over = np.isfinite(error) and error > width[node]
        bar_colour = theme.down if over else theme.fused
        numbers = (
            frame.traffic.sent[node], frame.traffic.missed[node], frame.traffic.rejected[node],
        )  # fmt: skip
        age = "-" if ages[node] < 0 else str(ages[node])
        cells.append(
            f'<tr data-node="{node}" data-state="{words[node]}" style="{marked}">'
            f'<td title="{escape(stage.names[node])}" style="text-align:left"><span style="color:'
            f'{css(colour)}">{MARKS[words[node]]}</span> '
            f"{escape(stage.names[node])}</td>"
            f"<td{_bad(theme, words[node] in (DOWN, REJECTED))}>"
            f"{words[node].upper() if words[node] == DOWN else words[node]}</td>"
            + "".join(f"<td>{number}</td>" for number in numbers)
            + f"<td>{age}</td>"
            f'<td class="why" style="padding-left:5px;background:linear-gradient(to right,'
            f"{css(bar_colour, 0.35)} {bar:.0f}%,"
            f'transparent {bar:.0f}%)">{_number(share * error)}</td>'
            f'<td class="why">{_number(share * width[node])}</td>'
            + (f'<td style="text-align:left">{escape(frame.rejection[node])}</td>' if told else "")
            + "</tr>"
        )
    more = ""
    if len(rows) < stage.nodes:
        more = f"<div>{len(rows)} of {stage.nodes} nodes; choose the order under View</div>"
    sigma = "set" if stage.set_valued else "3σ"
    shown = [sigma if head == "3σ" else head for head in _HEADINGS[: None if told else -1]]
    heads = "".join(
        f'<th title="{HEADINGS[head]}">{powered(head, power) if head in _SCALED else head}</th>'
        for head in shown
    )
    return (
        f"<style>.nodes td,.nodes th{{padding:1px 2px;text-align:right;"
        f"white-space:nowrap}}.nodes td:first-child{{max-width:max(72px,7vw);overflow:hidden;"
        f"text-overflow:ellipsis}}.nodes th{{color:"
        f"{css(theme.quiet)};font-weight:600;white-space:normal;vertical-align:top;"
        f"position:sticky;top:0;background:{css(theme.panel)}}}"
        f".why:hover{{text-decoration:underline}}"
        f".nodes tr{{cursor:pointer}}.nodes tr:hover td{{background-color:{css(theme.faint, 0.6)}}}"
        f'</style><div style="font-size:11px;color:{css(theme.text)};'
        f'overflow-x:auto;padding-right:8px">'
        f'<table class="nodes" data-testid="nodes" data-marks="nodes" style="border-collapse:'
        f'collapse;width:100%;font-variant-numeric:tabular-nums"><tr>{heads}</tr>{"".join(cells)}'
        f"</table>{more}</div>"
    )


def largest_deviation(frame: StepFrame) -> np.ndarray:
    """Return one standard deviation (N,) of the scored states, along the longest axis.

    It is half the length of the ellipse of 1σ, so that table and ellipses tell one figure.
    """
    states = list(frame.stage.score.states)
    cov = frame.belief.cov[:, states][:, :, states]
    known = np.isfinite(cov).all((1, 2))
    largest = np.full(len(cov), np.nan)
    largest[known] = np.linalg.eigvalsh(cov[known])[:, -1]
    return np.sqrt(np.maximum(largest, 0.0))


def chosen_rows(nodes: int, view: View, error: np.ndarray, ages: np.ndarray) -> list[int]:
    """Return the nodes that the table shows, in order; the selected one is always among them."""
    rows = list(range(nodes))
    if view.order == "error":
        rows = [int(i) for i in np.argsort(-np.nan_to_num(error, nan=-1.0), kind="stable")]
    elif view.order == "age":
        rows = [int(i) for i in np.argsort(-ages, kind="stable")]
    shown = rows[:MOST_ROWS]
    if view.selected is not None and view.selected not in shown:
        shown[-1] = view.selected
    return shown


def log(theme: Theme, events: Iterable[LogEntry]) -> str:
    """Return the newest events first."""
    lines = "".join(
        f'<div{_bad(theme, event.trouble)}><span style="color:{css(theme.quiet)};display:'
        f'inline-block;min-width:44px">{event.step}</span>{escape(event.text)}</div>'
        for event in events
    )
    return (
        f'<div data-testid="log" style="font-size:11.5px;padding:4px 10px;color:{css(theme.text)}">'
        f"{lines or 'nothing has happened yet'}</div>"
    )


def status(
    stage: Stage,
    theme: Theme,
    frame: StepFrame | None,
    state: str,
    detail: str = "",
    failures: Sequence[str] = (),
    waiting: Sequence[str] = (),
    judged: RunVerdict | None = None,
    mode: str = "",
) -> str:
    """Return the state of the run in a few lines, its verdict, the changes that wait, and the
    panels that fail. `mode` says how the shown step moves.

    The settings are those of the frame; those of `stage` where there is no frame.
    """
    colour = {
        "RUNNING": theme.fused,
        "PAUSED": theme.sending,
        "ENDED": theme.quiet,
        "SILENT": theme.down,
    }
    ground = colour.get(state.partition(" ")[0], theme.blind)
    pill = (
        f'<span data-testid="run-state" style="background:{css(ground)};'
        f"color:{css(letters_on(ground))};border-radius:10px;padding:2px 10px;font-weight:700;"
        f'display:inline-block;font-size:11px">{escape(state)}</span> '
        f'<span data-testid="mode" style="font-weight:600;font-size:11px">{escape(mode)}</span> '
        f'<span style="color:{css(theme.quiet)};font-size:11px">{escape(detail)}</span>'
    )
    rows: list[tuple[str, str, str, str]] = []
    if frame is not None:
        stage = frame.stage
        unit, name = stage.score.unit.removeprefix("1"), stage.error_name
        means = chart_meanings(stage)[name]
        rows = [
            ("step", "step", f"{frame.step}", "number of the shown step, from 0"),
            ("time", "time", f"{frame.time_s:.4g} s", "time of the plant"),
            ("alive", "alive", f"{int(frame.alive.sum())} / {stage.nodes}", "nodes that are up"),
            ("links cut", "cut", f"{int(frame.cut.sum())} / {len(stage.edges)}", "of all links"),
            (name, "rmse", f"{_number(frame.scores.rmse)} {unit}".strip(), means),
        ]
        if np.isfinite(frame.scores.central):
            central = f"{_number(frame.scores.central)} {unit}".strip()
            rows.append(("centralised", "central", central, "error of that filter in this step"))
    lines = "".join(
        f'<div title="{meaning}" style="display:flex;justify-content:space-between"><span '
        f'style="color:{css(theme.quiet)}">{name}</span><b data-testid="{key}">{escape(value)}</b>'
        "</div>"
        for name, key, value, meaning in rows
    )
    failed = "".join(
        f'<div data-testid="failure" style="margin-top:5px;font-size:11px;'
        f'color:{ink(theme, theme.down)}">{escape(failure)}</div>'
        for failure in failures
    )
    pill += _verdict(theme, frame, state == "PAUSED", judged)
    failed += _waiting(waiting)
    scenario = stage.setup.scenario
    graph, rule = scenario.network.graph, scenario.rule.name
    graph = f"{len(stage.edges)} links" if graph.startswith("edges:") else escape(graph)
    rounds = f"{scenario.rounds} round{'s' * (scenario.rounds != 1)}"
    about = f"{escape(scenario.name)}, {graph}, {rule}, {rounds}"
    return (
        f'<div class="concord-status" style="font-size:12.5px;color:{css(theme.text)};'
        f'padding:4px 12px">{pill}'
        f'<div class="concord-about" style="margin:5px 0;color:{css(theme.quiet)};font-size:11px">'
        f"{about}</div>"
        f"{lines}{failed}</div>"
    )


def _bad(theme: Theme, holds: bool) -> str:
    return f' style="color:{ink(theme, theme.down)};font-weight:600"' if holds else ""


def _number(value: float) -> str:
    return "-" if not np.isfinite(value) else rounded(value)


def _verdict(
    theme: Theme, frame: StepFrame | None, is_paused: bool, judged: RunVerdict | None
) -> str:
    """Return the verdict with the health of the network, or why there is nothing to judge."""
    if frame is None and is_paused:
        return (
            f'<div data-testid="empty" style="margin-top:7px;color:{css(theme.text)}">The page has '
            "no step yet; press Step, or N, for the next one.</div>"
        )
    if judged is None or frame is None:
        return ""
    ill = health(frame)
    ailing = ill and (
        f' <span data-testid="health" style="font-size:12px;font-weight:600;'
        f'color:{ink(theme, theme.sending if theme.dark else theme.down)}">{ill}</span>'
    )
    good = {True: theme.fused, False: theme.down, None: theme.quiet}[judged.is_good]
    return (
        f'<div style="margin-top:7px"><b data-testid="verdict" style="font-size:15px;'
        f'color:{ink(theme, good)}">{escape(judged.word)}</b>{ailing}<div style="font-size:11px;'
        f'color:{css(theme.quiet)}">{escape(judged.reason)}</div></div>'
    )


def _waiting(changes: Sequence[str]) -> str:
    if not changes:
        return ""
    count = f"{len(changes)} change{'s' * (len(changes) > 1)}"
    return (
        f'<div data-testid="waiting" style="margin-top:5px;font-size:11px">{count} from the '
        f"next step on: {escape('; '.join(changes))}</div>"
    )
