"""The legend of the page and its help: each mark, heading and chart in a few words."""

from html import escape

from concord.dashboard.explain.tooltips import chart_meanings
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.verdict import STEPS
from concord.dashboard.scene.legend import meanings
from concord.dashboard.theme import Theme, css
from concord.dashboard.view import View

HEADINGS = {
    "node": "name of the node",
    "state": "condition of the node in this step",
    "sent": "frames that the node has sent since the start",
    "miss": "frames that did not reach the node since the start",
    "rej": "frames that the node has rejected since the start",
    "age": "cycles since the oldest share that the node holds of a neighbour was sent",
    "error": "distance of the estimate from the truth, in the unit of the RMSE",
    "3σ": "three standard deviations along the longest axis of its ellipse, as the node believes",
    "set": "half-width of the set of the node",
    "rejected": "reason why the node last rejected a frame",
}
"""Headings of the table of nodes, with their meaning."""

_VERDICTS = {
    "CONSISTENT": "errors are as large as the nodes believe",
    "CAUTIOUS": "errors are smaller than the nodes believe",
    "OVERCONFIDENT": "errors are larger than the nodes believe, by the factor shown",
    "DISAGREEING": "estimates differ by more than the nodes believe",
}
_GESTURES = {
    "right button, or left with Ctrl": "on a node or a link: a menu of changes",
    "left button from node to node": "cuts the link, heals it, or adds one that the network lacks",
    "left button from a node to free ground": "a sensor that sees one target stands there",
}
_KEYS = {
    "P": "pause or resume", "N, B": "one step on, one back", "G": "newest step",
    "I, O": "loop from here, to here", "J, K": "next, previous node",
    "X": "select none", "D": "dark or light",
}  # fmt: skip


def help_panel(view: View, frame: StepFrame) -> str:
    """Return the legend of the scene, and the words of the page, as HTML."""
    theme = view.theme
    marks = "".join(
        f'<div><span style="color:{css(colour)};display:inline-block;width:20px">{sign}</span>'
        f"{escape(words)}</div>"
        for sign, colour, words in meanings(view, frame)
    )
    return (
        f'<div data-testid="help" style="font-size:11.5px;line-height:1.45;padding:4px 10px;'
        f'color:{css(theme.text)}">{_heading(theme, "In the scene")}{marks}'
        f"{_words(theme, f'Verdict on the last {STEPS} steps', _VERDICTS)}"
        f"{_words(theme, 'Table of nodes', HEADINGS)}"
        f"{_words(theme, 'Charts', chart_meanings(frame.stage))}"
        f"{_words(theme, 'Changes of a running network, in the scene', _GESTURES)}"
        f"{_words(theme, 'Keys', _KEYS)}</div>"
    )


def _heading(theme: Theme, text: str) -> str:
    return f'<div style="color:{css(theme.quiet)};margin-top:7px"><b>{text}</b></div>'


def _words(theme: Theme, heading: str, words: dict[str, str]) -> str:
    rows = "".join(f"<div><b>{name}</b>: {meaning}</div>" for name, meaning in words.items())
    return _heading(theme, heading) + rows
