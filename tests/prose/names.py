"""Names that the project retired, each with its replacement and the place where it is retired.

A retired word is looked for in prose, in identifiers, or in both. An ordinary English word is
retired only as an identifier, and only in the folders where it named the retired concept.
"""

import ast
import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple


class Retired(NamedTuple):
    """A word, its replacement, and where it is looked for; no folder means every folder."""

    word: str
    becomes: str
    in_prose: bool = True
    in_identifiers: bool = True
    folders: tuple[str, ...] = ()

    def holds_in(self, path: str) -> bool:
        """Say whether the word is retired in a file."""
        return not self.folders or path.startswith(self.folders)


_NETWORK = ("nodes/", "scenarios/", "runtime/")
# Features came from these folders and from others, where some words kept their English meaning.
_FEATURES = (*_NETWORK, "features/")
_STUDIES = ("experiments/", "results/", "studies/")


def _identifier(word: str, becomes: str, *folders: str) -> Retired:
    return Retired(word, becomes, in_prose=False, folders=folders)


def _prose(word: str, becomes: str) -> Retired:
    return Retired(word, becomes, in_identifiers=False)


RETIRED = (
    Retired("zygote", "launcher process"),
    Retired("conductor", "run controller"),
    Retired("office", "environment process"),
    _identifier("member", "node process", *_FEATURES),
    _identifier("player", "real-time node process", *_FEATURES),
    _identifier("said", "republisher", *_NETWORK),
    _identifier("repeats", "retransmission", *_FEATURES),
    Retired("patience", "peer timeout"),
    Retired("absence", "departed peers"),
    _identifier("listen", "baseline filter", "nodes/", "scenarios/", "runtime/batched/"),
    _identifier("carry", "predict", "filters/", *_FEATURES),
    _identifier("take", "update", "filters/", "nodes/rules/", "nodes/lanes/"),
    Retired("sharpness", "inverse volume"),
    _prose("part of a cycle", "group"),
    _prose("parts of a cycle", "group"),
    _prose("part of the cycle", "group"),
    _prose("parts of the cycle", "group"),
    _identifier("part", "group", *_NETWORK),
    Retired("torture", "simulation testing"),
    _identifier("books", "oracle ledger", "tests/laboratory/"),
    Retired("fates", "outcomes"),
    _identifier("page", "oracle ledger", "tests/laboratory/"),
    Retired("world", "environment"),
    Retired("seat", "node context"),
    Retired("fleet", "batched rule"),
    Retired("era", "segment"),
    Retired("regime", "settings"),
    _identifier("turning", "change", *_NETWORK),
    _identifier("turnings", "changes", *_FEATURES),
    Retired("hearing", "inbox"),
    Retired("offering", "throttled feed"),
    Retired("watchers", "subscribers"),
    _identifier("around", "estimator wrapper", *_NETWORK),
    Retired("weigh up", "to information"),
    Retired("conclude", "from information"),
    _identifier("certain", "set-valued", "filters/", *_STUDIES, *_FEATURES),
    Retired("troubles", "failures"),
    _identifier("Kind", "scenario definition", *_STUDIES, *_FEATURES),
)


_ANY = re.compile("|".join(retired.word for retired in RETIRED), re.IGNORECASE)
# Names of the literature that contain a retired word.
_TERMS = re.compile(r"small[ _-]world", re.IGNORECASE)


def retired_in_prose(path: str, text: str) -> Iterator[Retired]:
    """Yield each retired word that a block of prose contains, once."""
    text = _TERMS.sub("", text)
    if not _ANY.search(text):
        return
    for retired in RETIRED:
        if retired.in_prose and retired.holds_in(path):
            plural = "" if " " in retired.word else "s?"
            if re.search(rf"\b{retired.word}{plural}\b", text, re.IGNORECASE):
                yield retired


def defined(nodes: Iterable[ast.AST]) -> Iterator[tuple[int, str]]:
    """Yield line and name of everything that a file defines: functions, classes, arguments, fields
    and variables."""
    for node in nodes:
        match node:
            case (
                ast.FunctionDef(name=name)
                | ast.AsyncFunctionDef(name=name)
                | ast.ClassDef(name=name)
            ):
                yield node.lineno, name
            case ast.arg(arg=name):
                yield node.lineno, name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield node.lineno, name


def words_of(name: str) -> list[str]:
    """Split an identifier into its words."""
    return [
        word for part in name.split("_") for word in re.findall(r"[A-Z]?[a-z0-9]+|[A-Z]+", part)
    ]


def retired_in_identifier(path: str, name: str) -> Iterator[Retired]:
    """Yield each retired word that an identifier contains.

    A word that is retired in prose too may not be a part of an identifier; an ordinary English word
    may not be the whole of one.
    """
    words = words_of(_TERMS.sub("", name))
    text = f" {' '.join(words).lower()} "
    if not _ANY.search(text):
        return
    for retired in RETIRED:
        if not (retired.in_identifiers and retired.holds_in(path)):
            continue
        if not retired.in_prose:
            if name.lstrip("_") == retired.word:
                yield retired
        elif f" {retired.word} " in text or f" {retired.word}s " in text:
            yield retired
