"""A report as a page: headings, paragraphs, tables and pictures, as HTML, Markdown or LaTeX."""

import base64
import html
from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em;
       color: #222; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 10px; text-align: right; border-bottom: 1px solid #ddd; }
th { border-bottom: 2px solid #888; text-align: right; }
td.text, th.text { text-align: left; }
img { max-width: 100%; }
pre { background: #f5f5f5; padding: 8px; overflow-x: auto; }
.wide { overflow-x: auto; }
"""

_LATEX = {"\\": r"\textbackslash{}", **{sign: f"\\{sign}" for sign in "&%$#_{}"},
          "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "×": r"$\times$",
          "µ": r"$\mu$", "²": "$^2$", "°": r"$^\circ$", "√": r"$\surd$"}  # fmt: skip
_ROWS_OF_A_PAGE = 45


class Heading(NamedTuple):
    """A heading of level 1 or 2."""

    text: str
    level: int = 2


class Paragraph(NamedTuple):
    """Plain text."""

    text: str


class Code(NamedTuple):
    """A command, or data as text."""

    text: str


class Grid(NamedTuple):
    """A table; the first `texts` columns are words, the others numbers."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int


class ReportPicture(NamedTuple):
    """A picture as PNG bytes, and what it is called."""

    name: str
    png: bytes


PagePart = Heading | Paragraph | Code | Grid | ReportPicture


def picture(name: str, figure: "Figure") -> ReportPicture:
    """A figure as a picture of a page."""
    import matplotlib.pyplot as plt

    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    plt.close(figure)
    return ReportPicture(name, buffer.getvalue())


def as_html(title: str, parts: Sequence[PagePart]) -> str:
    """One page that needs no other file."""
    body = "\n".join(_html(part) for part in parts)
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"<title>{html.escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}\n"
        "</body>\n</html>\n"
    )


def as_markdown(parts: Sequence[PagePart]) -> str:
    """Return the page as Markdown; pictures are inside, as data."""
    return "\n\n".join(_markdown(part) for part in parts) + "\n"


def as_latex(parts: Sequence[PagePart]) -> str:
    """Return the tables for a LaTeX document, and all other text as comments; no pictures."""
    found = "\n".join(filter(None, map(_latex, parts)))
    needs = ["booktabs", *(["longtable"] if r"\begin{longtable}" in found else [])]
    return f"% \\usepackage{{{','.join(needs)}}}\n{found}\n"


def _latex(part: PagePart) -> str:
    match part:
        case Heading(text) | Paragraph(text) | Code(text):
            return "\n".join(f"% {line}".rstrip() for line in text.splitlines())
        case Grid(head, rows, texts):
            is_long = len(rows) > _ROWS_OF_A_PAGE
            kind = "longtable" if is_long else "tabular"
            columns = "l" * texts + "r" * (len(head) - texts)
            top, *lines = (rf"{' & '.join(map(_in_latex, row))} \\" for row in (head, *rows))
            begin = [rf"\begin{{{kind}}}{{{columns}}}", r"\toprule", top, r"\midrule"]
            above = [r"\endhead"] if is_long else []
            return "\n".join((*begin, *above, *lines, r"\bottomrule", rf"\end{{{kind}}}"))
    return ""


def _in_latex(text: str) -> str:
    return "".join(_LATEX.get(sign, sign) for sign in text)


def _html(part: PagePart) -> str:
    match part:
        case Heading(text, level):
            return f"<h{level}>{html.escape(text)}</h{level}>"
        case Paragraph(text):
            return f"<p>{html.escape(text)}</p>"
        case Code(text):
            return f"<pre>{html.escape(text)}</pre>"
        case ReportPicture(name, png):
            return f'<p><img alt="{html.escape(name)}" src="{_data(png)}"></p>'
        case Grid(head, rows, texts):
            lines = [_row("th", head, texts), *(_row("td", row, texts) for row in rows)]
            return '<div class="wide"><table>\n' + "\n".join(lines) + "\n</table></div>"


def _row(tag: str, cells: Sequence[str], texts: int) -> str:
    written = [
        f"<{tag}{' class=text' if place < texts else ''}>{html.escape(cell)}</{tag}>"
        for place, cell in enumerate(cells)
    ]
    return f"<tr>{''.join(written)}</tr>"


def _markdown(part: PagePart) -> str:
    match part:
        case Heading(text, level):
            return f"{'#' * level} {text}"
        case Paragraph(text):
            return text
        case Code(text):
            return "\n".join(f"    {line}" for line in text.splitlines())
        case ReportPicture(name, png):
            return f"![{name}]({_data(png)})"
        case Grid(head, rows, texts):
            rule = ["---" if place < texts else "---:" for place in range(len(head))]
            return "\n".join(f"| {' | '.join(row)} |" for row in (head, rule, *rows))


def _data(png: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"
