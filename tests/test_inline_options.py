"""Options that pages, docstrings and messages name inside sentences exist."""

import contextlib
import io
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from concord.entries import chosen, entries
from concord.experiments.cli.command_line import main

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


@cache
def options_of(command: tuple[str, ...]) -> frozenset[str]:
    """The options that the help of a command shows."""
    return frozenset(re.findall(r"--[a-z][a-z0-9-]*", _help(command)))


@cache
def _help(command: tuple[str, ...]) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit):
        main([*command, "--help-all"])
    return out.getvalue()


def every_option() -> frozenset[str]:
    """The options of all commands."""
    names = [(name, *word) for name in entries("COMMANDS") for word in ((), *_words_of(name))]
    return frozenset().union(*map(options_of, names))


def _words_of(name: str) -> list[tuple[str, ...]]:
    """The commands of a group."""
    loaded = chosen("COMMANDS", name)
    return [(inner,) for inner in loaded] if isinstance(loaded, dict) else []


def inline_code(page: Path) -> Iterator[str]:
    """The code inside the sentences of a page."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    yield from (" ".join(code.split()) for code in re.findall(r"(?<!`)`([^`]+)`(?!`)", text))


def unknown_options(code: str) -> set[str]:
    """The options in a piece of code that its command does not have, or no command at all."""
    asked = set(re.findall(r"(?<!\S)--[a-z][a-z0-9-]*", code))
    if code.startswith("--"):
        return asked - every_option()
    if not code.startswith("concord "):
        return set()
    words = code.split()[1:]
    if words[0] not in entries("COMMANDS"):
        return set() if words[0] == "--version" else {words[0]}
    command = tuple(words[: 1 + (bool(_words_of(words[0])) and len(words) > 1)])
    return asked - options_of(command)


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch):
    """No option is broken at the end of a line."""
    monkeypatch.setenv("COLUMNS", "400")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_options_inside_sentences_exist(page: Path):
    for code in inline_code(page):
        assert not unknown_options(code), f"`{code}`: {unknown_options(code)}"


@pytest.mark.parametrize(
    ("code", "unknown"),
    [
        ("--no-linear", set()),
        ("--no-adaptive", {"--no-adaptive"}),
        ("concord run --filter aukf", set()),
        ("concord plot --filter aukf", {"--filter"}),
        ("concord identity --data DIR", {"identity"}),
        ("concord flexray wcrt SLOTS.toml --cluster audi", set()),
        ("pip --anything", set()),
    ],
)
def test_an_option_that_does_not_exist_is_found(code: str, unknown: set[str]):
    assert unknown_options(code) == unknown
