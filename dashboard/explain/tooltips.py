"""Tooltips of headings that viser draws: tabs, folders, titles of charts.

viser gives tabs their own names as tooltips, and the others none. So a script in the page gives
each heading its `title` as soon as a pointer comes to it. The script also opens the tab *Selected*
at a press on a number with the class `why`. It leans on viser's page; the version of viser is
pinned, and a browser test fails if that changes.
"""

import json
from html import escape

from concord.dashboard.frames.stage import Stage

HEADINGS = {
    "Charts": "the scores of the network over time",
    "One state": "one state of the selected node over time; choose it under View",
    "Log": "events of the run, newest first",
    "Nodes": "a row for each node; press a number to see what made it",
    "Selected": "the belief of the selected node, and the shares that made it",
    "Help": "what marks, words and headings mean",
    "Ratios": "the figures of two runs, and their ratios",
    "Bus": "the frames of the shown cycle to scale, and the cycles before",
    "Beliefs": "two states of all nodes, about the truth",
    "States": "all states of the plant, with the estimate of one node",
    "Run": "pace of the network or of the recording",
    "Network": "settings of all nodes; they hold from the next step",
    "Node and link": "faults of one node or one link; they hold from the next step",
    "View": "what this page shows; it changes nothing in the network",
    "Export": "files to keep or to send",
}
"""Headings of tabs and folders, with their meaning."""

CHARTS = {
    "RMSE": "root mean square error of the nodes; centralised is one filter that hears every "
    "sensor; no filter beats the Cramér-Rao bound on the average",
    "Disagreement": "root mean square distance of the estimates from their mean",
    "NEES": "normalised estimation error squared; consistent nodes stay between the dashed lines",
    "NIS": "normalised innovation squared over its degrees of freedom: 1 is right, and the dashed "
    "line holds 95 % of the steps; it needs no truth",
    "Payload": "bytes of shares on the bus",
}
"""First words of the titles of charts, with the meaning of the chart; see `chart_meanings`."""

# A press on a number is heard before the panel that holds it is drawn again.
_SCRIPT = (
    "if(!window.concordTooltips){window.concordTooltips=1;const heads=%s,charts=%s;"
    "document.addEventListener('pointerover',e=>{const t=e.target.closest('[role=tab],.u-title')"
    "??e.target,text=t.textContent?.length<90?t.textContent.trim():'';"
    "const told=t.matches('.u-title')?charts[Object.keys(charts).find(k=>text.startsWith(k))]:"
    "heads[text];if(told&&t.title!==told)t.title=told});"
    "document.addEventListener('pointerdown',e=>{if(!e.target.closest('.why'))return;"
    "const tab=[...document.querySelectorAll('[role=tab]')]"
    ".find(t=>t.textContent.trim()==='Selected'),box=tab?.getBoundingClientRect();"
    "for(const type of box?['pointerdown','pointerup']:[])tab.dispatchEvent(new PointerEvent(type,"
    "{bubbles:true,isPrimary:true,pointerId:e.pointerId,clientX:box.x+5,clientY:box.y+5}))})}"
)


def chart_meanings(stage: Stage) -> dict[str, str]:
    """Return `CHARTS`, with those of the scenario's own charts."""
    return CHARTS if stage.own is None else {**CHARTS, **stage.own.meanings}


def tooltips(stage: Stage) -> str:
    """Return the script as HTML; an image without a source fails, and runs it, at once."""
    words = HEADINGS, chart_meanings(stage)
    script = _SCRIPT % tuple(json.dumps(one, ensure_ascii=False) for one in words)
    return f'<img src="data:," alt="" style="display:none" onerror="{escape(script)}">'
