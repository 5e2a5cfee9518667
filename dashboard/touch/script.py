"""The changes of a run as a script for `--changes`, from what the network announced."""

from collections.abc import Iterable
from html import escape

from concord.dashboard.frames.frame import LogEntry
from concord.dashboard.theme import Theme, css

_ONE_WAY = " one-way"


def script_of(events: Iterable[LogEntry]) -> list[str]:
    """Return one line for each change, each with the step from which it held.

    A link is announced direction by direction; both at one step are one line.
    """
    lines: list[str] = []
    for event in events:
        if not event.words:
            continue
        line = f"{event.step} {event.words}"
        both = _turned(line)
        if both in lines:
            lines[lines.index(both)] = both.removesuffix(_ONE_WAY)
        else:
            lines.append(line)
    return lines


def _turned(line: str) -> str:
    """Return the line for the other direction of its link; "" for one that names no direction."""
    if not line.endswith(_ONE_WAY):
        return ""
    *before, sender, receiver = line.removesuffix(_ONE_WAY).split()
    return " ".join((*before, receiver, sender)) + _ONE_WAY


def as_option(lines: Iterable[str]) -> str:
    """Return the lines as the option of a command."""
    return "--changes " + " ".join(f'"{line}"' for line in lines)


# A page that is not of this machine has no clipboard; then the text is selected.
_COPY = (
    "const text=this.nextElementSibling;if(navigator.clipboard)navigator.clipboard.writeText("
    "text.textContent).then(()=>{this.textContent='copied'});else getSelection().selectAllChildren("
    "text)"
)


def script_panel(theme: Theme, events: Iterable[LogEntry]) -> str:
    """Return the script of the run so far with a button that copies it; "" where there is none."""
    lines = script_of(events)
    if not lines:
        return ""
    style = f"border:1px solid {css(theme.quiet)};border-radius:4px;padding:1px 8px;font-size:11px"
    return (
        f'<div style="font-size:11.5px;padding:6px 10px;color:{css(theme.text)}"><div style="color:'
        f'{css(theme.quiet)}">the same changes in another run</div><button data-testid="copy" '
        f'style="{style};cursor:pointer" onclick="{_COPY}">copy</button><code data-testid="script" '
        f'style="display:block;white-space:pre-wrap">{escape(as_option(lines))}</code></div>'
    )
