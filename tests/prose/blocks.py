"""Blocks of prose in a file: docstrings and comments of Python and C++, paragraphs of Markdown.

A block is text that a reader takes in one piece: a paragraph, a list item, a table cell, a heading.
Code and quotations are replaced by one placeholder word each, so that no rule looks at them.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

PLACEHOLDER = "Quoted"
_QUOTED = re.compile(
    r"``[^`]+``|`[^`]+`|\"[^\"]{1,400}\"|“[^”]{1,400}”|\$[^$]+\$|<[^<>\s][^<>]*>|https?://\S+"
)
# As in CommonMark, only an item numbered 1 may follow a paragraph without a blank line.
_ITEM = re.compile(r"\s*(?:[-*+]|1[.)])\s+")
_NUMBERED_ITEM = re.compile(r"\s*\d+[.)]\s+")
_DIRECTIVE = re.compile(r"#\s*(?:noqa|type:|fmt:|pyright:|ruff:|!|pragma)|#\s*-{3,}")


class Block(NamedTuple):
    """Prose without code and quotations, with the number of its first line."""

    line: int
    text: str


def blocks(path: Path) -> list[Block]:
    """Return the prose of a file by its suffix; a file of another kind has none."""
    text = path.read_text(encoding="utf-8")
    match path.suffix:
        case ".py":
            return [*_python_docstrings(text), *_python_comments(text)]
        case ".md":
            return list(_markdown(text))
    return []


def without_quotations(text: str) -> str:
    """Replace code, quotations and addresses by one word each, and join the lines."""
    return " ".join(_QUOTED.sub(PLACEHOLDER, " ".join(text.split())).split())


@lru_cache(maxsize=1)
def python_nodes(text: str) -> list[ast.AST]:
    """Return the nodes of the syntax tree of a text, in the order of ast.walk."""
    return list(ast.walk(ast.parse(text)))


def _python_docstrings(text: str) -> Iterator[Block]:
    """Yield each string that stands alone: docstrings, and the help of fields and constants."""
    for node in python_nodes(text):
        match node:
            case ast.Expr(value=ast.Constant(value=str(words))):
                yield from _paragraphs(words.splitlines(), node.lineno)


def _python_comments(text: str) -> Iterator[Block]:
    """Yield comments; full-line comments on consecutive lines are one block."""
    run: list[str] = []
    first = last = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT or _DIRECTIVE.match(token.string):
            continue
        line, whole = token.start[0], token.line.lstrip().startswith("#")
        if run and not (whole and line == last + 1):
            yield from _paragraphs(run, first)
            run = []
        if not run:
            first = line
        run.append(token.string.lstrip("#").strip())
        last = line if whole else -1
    yield from _paragraphs(run, first)


def _markdown(text: str) -> Iterator[Block]:
    """Yield paragraphs, items, headings and cells, without code, formulas and block quotations.

    Four spaces after a blank line begin a block of code or formulas, as in CommonMark.
    """
    lines: list[str] = []
    fence = ""
    indented = False
    for line in text.splitlines():
        mark = re.match(r"\s*(```|~~~)", line)
        if mark and (not fence or mark[1] == fence):
            fence = "" if fence else mark[1]
            lines.append("")
        else:
            after_blank = not lines or not lines[-1]
            indented = line.startswith("    ") and (indented or after_blank)
            left_out = fence or indented or re.match(r"\s*[<>]", line)
            lines.append("" if left_out else re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", line))
    yield from _paragraphs(lines, 1)


def _paragraphs(lines: list[str], first: int) -> Iterator[Block]:
    """Split lines at blank lines, items, headings, table rows and doctests."""
    run: list[str] = []
    begun, numbered = first, False
    for number, line in enumerate([*lines, ""], start=first):
        bare = line.strip()
        cells = bare.startswith("|")
        alone = cells or bare.startswith(("#", ">>>", "...", "```"))
        item = (_NUMBERED_ITEM if numbered or not run else _ITEM).match(line) or _ITEM.match(line)
        if run and (not bare or alone or item):
            yield Block(begun, without_quotations(" ".join(run)))
            run = []
        if cells:
            for cell in bare.strip("|").split(" | "):
                yield Block(number, without_quotations(cell))
        elif bare.startswith("#"):
            yield Block(number, without_quotations(bare.lstrip("# ")))
        elif bare and not alone:
            if not run:
                begun, numbered = number, bool(_NUMBERED_ITEM.match(line))
            run.append(line[item.end() :] if item else bare)
