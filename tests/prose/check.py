"""Findings of the prose rules in files, each with its file, its line and the rule."""

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from tests.prose.blocks import Block, blocks, python_nodes
from tests.prose.names import defined, retired_in_identifier, retired_in_prose

ROOT = Path(__file__).resolve().parents[2]
MOST_WORDS = 35
SUFFIXES = (".py", ".md")
# Names are retired in the product and its pages; a test may use a retired word to look for it.
_UNNAMED = ("tests/",)
# At the start of a line of a text that git wrote for two versions of it.
_OF_A_MERGE = (7 * "<" + " ", 7 * ">" + " ")
_OPENING = re.compile(
    r"(?:Who|Whoever|Nobody|Somebody|What|All that|Such|One that)\b", re.IGNORECASE
)
_ABBREVIATION = re.compile(r"\b(?:e\.g|i\.e|cf|vs|al|eq|eqs|fig|sec|no|pp?|resp|approx)\.$", re.I)
_END = re.compile(r"(?<=[.!?])[)\]*]*\s+(?=[\w(\[*-])")


class Finding(NamedTuple):
    """A sentence or a name that breaks a rule."""

    path: str
    line: int
    rule: str
    text: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.rule}: {self.text}"


def sentences(text: str) -> Iterator[str]:
    """Split a block into sentences; an abbreviation ends none."""
    begun = 0
    for end in _END.finditer(text):
        if not _ABBREVIATION.search(text[begun : end.start()]):
            yield text[begun : end.end()].strip()
            begun = end.end()
    if text[begun:].strip():
        yield text[begun:].strip()


def words(sentence: str) -> list[str]:
    """Return the words of a sentence; signs and operators are none."""
    return [word for word in sentence.split() if re.search(r"\w", word)]


def sentence_findings(path: str, block: Block) -> Iterator[Finding]:
    """Yield sentences that open with a banned pronoun or are too long; a question may open so."""
    for sentence in sentences(block.text):
        count = len(words(sentence))
        opening = _OPENING.match(sentence)
        if opening and count > 2 and not sentence.endswith("?"):
            rule = f"opens with '{opening[0]}'; name the subject"
            yield Finding(path, block.line, rule, sentence)
        if count > MOST_WORDS:
            rule = f"{count} words, at most {MOST_WORDS}; one fact a sentence"
            yield Finding(path, block.line, rule, sentence)


def name_findings(path: str, text: str, prose: Iterable[Block]) -> Iterator[Finding]:
    """Yield retired words in prose, in the file's own name and in the names that it defines."""
    for block in prose:
        for retired in retired_in_prose(path, block.text):
            rule = f"'{retired.word}' is retired; write '{retired.becomes}'"
            yield Finding(path, block.line, rule, block.text)
    if not path.endswith(".py"):
        return
    named = {*defined(python_nodes(text)), (1, Path(path).stem)}
    for line, name in sorted(named):
        for retired in retired_in_identifier(path, name):
            rule = f"'{retired.word}' is retired; name it '{retired.becomes}'"
            yield Finding(path, line, rule, name)


def merge_findings(path: str, text: str) -> Iterator[Finding]:
    """Yield the lines at which a merge begins or ends that was left open."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith(_OF_A_MERGE):
            yield Finding(path, number, "a merge was left open; choose a text", line)


def findings(file: Path, root: Path = ROOT) -> list[Finding]:
    """Return every finding in one file, by line."""
    path, text = file.relative_to(root).as_posix(), file.read_text(encoding="utf-8")
    if found := list(merge_findings(path, text)):
        return found
    prose = blocks(file)
    found = [finding for block in prose for finding in sentence_findings(path, block)]
    if not path.startswith(_UNNAMED):
        found += name_findings(path, text, prose)
    return sorted(found, key=lambda finding: finding.line)


def files(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield the checked files at or below paths, without hidden folders, links and runs."""
    for path in paths:
        for file in _below(path) if path.is_dir() else [path]:
            if file.suffix in SUFFIXES:
                yield file


def _below(root: Path) -> Iterator[Path]:
    for folder, folders, names in os.walk(root):
        folders[:] = sorted(
            name for name in folders if not name.startswith(".") and name not in ("runs", "build")
        )
        yield from (Path(folder, name) for name in sorted(names))
