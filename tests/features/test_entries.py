"""Entries of core, features and packages: names, summaries, targets, and what is refused."""

import inspect
from pathlib import Path

import pytest

from concord.entries import KINDS, Entry, entries, member
from tests.features.commands import commands, python
from tests.prose.check import sentences

TWICE = 'RULES = {"wac": ("json:loads", "Another rule.")}'


ENTRIES = [
    pytest.param(entry, id=f"{kind.lower()}-{name}")
    for kind in KINDS
    for name, entry in entries(kind).items()
    if entry.options or kind == "COMMANDS"
]


def first_paragraph(docstring: str | None) -> str:
    """Return the first paragraph of a docstring as one line."""
    return " ".join(inspect.cleandoc(docstring or "").partition("\n\n")[0].split())


def installed(folder: Path, name: str, module: str) -> Path:
    """Install a package of one module of entries in a folder, as pip does."""
    (folder / f"{name}.py").write_text(module)
    information = folder / f"{name}-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[concord.features]\n{name} = {name}\n")
    return folder


def refusal(folder: Path, tmp_path: Path) -> str:
    """Return the error output of a command that chooses among rules; it is no traceback."""
    choose = commands(["run", "--scenario", "oscillator", "--steps", "1", "--rule", "wac"])
    with pytest.raises(AssertionError) as refused:
        python(folder, tmp_path, choose)
    assert "Traceback" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("entry", ENTRIES)
def test_a_summary_is_that_of_the_options_or_of_the_command(entry: Entry):
    described = member(entry.options or entry.target)
    if isinstance(described, dict):
        assert entry.summary, "a group of commands has no docstring"
    elif entry.options:
        assert entry.summary == next(sentences(first_paragraph(described.__doc__)))
    else:
        assert entry.summary == first_paragraph(described.__doc__)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "CASES"])
def test_every_target_can_be_loaded(kind: str):
    for name, entry in entries(kind).items():
        assert not entry.target or member(entry.target) is not None, name


def test_a_name_given_twice_is_refused_with_both_owners(tmp_path: Path):
    message = refusal(installed(tmp_path, "twice", TWICE), tmp_path)
    assert "rules 'wac' of package twice: concord.scenarios has the name already" in message
    assert "rename the entry in twice" in message


def test_a_package_whose_entries_cannot_be_read_is_refused(tmp_path: Path):
    message = refusal(installed(tmp_path, "broken", "import nothing_of_the_name"), tmp_path)
    assert "package broken: its entries broken cannot be read" in message
    assert "No module named 'nothing_of_the_name'" in message


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("nothing_of_the_name:RULE", "No module named .*; install what is missing, or uninstall"),
        ("concord.entries:RULE", "concord.entries has no RULE; correct the entry of its package"),
    ],
)
def test_an_entry_without_its_target_is_refused(target: str, says: str):
    with pytest.raises(ValueError, match=says):
        member(target)
