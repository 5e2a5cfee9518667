"""The charts to take away: drawn on paper, whatever the page looks like."""

import io
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.chart import Drawn
from concord.dashboard.theme import Colour, css
from concord.dashboard.view import View

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH_IN, _ROW_IN, _DPI = 9.0, 2.5, 150


def charts_page(stage: Stage, charts: Sequence[Drawn], view: View) -> str:
    """All charts as one page of SVG: no script, opens anywhere, prints well."""
    title = escape(_title(stage, view))
    drawn = "".join(f"<p>{_svg(_figure([chart]))}</p>" for chart in _told(charts))
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>'
        "<style>body{font:14px sans-serif;max-width:940px;margin:2em auto;color:#222}"
        f"h1{{font-size:17px}}svg{{width:100%;height:auto}}</style><h1>{title}</h1>"
        f"{drawn}</html>\n"
    )


def charts_picture(stage: Stage, charts: Sequence[Drawn], view: View) -> bytes:
    """All charts, one below the other, as PNG."""
    figure = _figure(_told(charts), _title(stage, view))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def _title(stage: Stage, view: View) -> str:
    scenario = stage.setup.scenario
    return (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.rule.name}, seed {scenario.seed}, "
        f"up to step {view.step}"
    )


def _told(charts: Sequence[Drawn]) -> list[Drawn]:
    """Those that show anything."""
    return [
        chart for chart in charts if any(np.isfinite(curve.values).any() for curve in chart.curves)
    ]


def _figure(charts: Sequence[Drawn], title: str = "") -> "Figure":
    # Loading matplotlib takes longer than the picture.
    from matplotlib.figure import Figure

    figure = Figure((_WIDTH_IN, _ROW_IN * max(len(charts), 1)), layout="constrained")
    figure.suptitle(title, fontsize=11)
    for place, chart in enumerate(charts):
        _draw(figure.add_subplot(len(charts), 1, place + 1), chart)
    return figure


def _draw(axes: Any, chart: Drawn) -> None:
    for curve in chart.curves:
        if np.isfinite(curve.values).any():
            style, colour = "--" if curve.dashed else "-", _on_paper(curve.colour)
            axes.plot(
                chart.times, curve.values, style, color=colour, linewidth=1.3, label=curve.name
            )
    if chart.is_logarithmic:
        axes.set_yscale("log")
    axes.set_title(chart.title, fontsize=10)
    axes.set_xlabel("time [s]", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper right")


def _on_paper(colour: Colour) -> str:
    """A colour that can be seen on white."""
    return "#333333" if sum(colour) > 600 else css(colour)


def _svg(figure: "Figure") -> str:
    from matplotlib import rc_context

    buffer = io.StringIO()
    # Text stays text; and the same charts give the same bytes.
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "concord"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    written = buffer.getvalue()
    return written[written.index("<svg") :]
