"""Code and files that a received folder names: they are used where a run of this user named them.

A folder of results may come from anywhere, and its digests with it. So a reader asks the user's own
list, in $XDG_STATE_HOME/concord (or ~/.local/state/concord), before any code of a folder runs.
"""

import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from concord.scenarios.user.values import is_source_name

_FILES = ("file:", "directed:")
_WORDS = re.compile(r"[\s=,;@]+")


class UnknownCode(ValueError):
    """A folder of results names code or files that no run of this user has named."""


_known: set[str] = set()
_trusted: list[Path] = []


def trust(place: Path | None) -> None:
    """Let this process use the code and files that results below a folder name; None for none.

    Raises:
        ValueError: there is no such folder or file.
    """
    if place is None:
        return
    if not place.exists():
        raise ValueError(f"--trust {place}: does not exist; name the folder whose code may run")
    _trusted.append(place.resolve())


def remember(asked: msgspec.Struct) -> None:
    """Keep the files that a scenario of this user names, in the user's list."""
    new = {mark for _, mark in _named(msgspec.to_builtins(asked))} - _known
    if not new or not (new := new - _own_list()):
        return
    _known.update(new)
    # A run needs no list: without one, reading its folder asks for --trust.
    with suppress(OSError):
        path = _list_file()
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600), "w") as file:
            file.write("".join(f"{mark}\n" for mark in sorted(new)))


def require_known(received: msgspec.Struct | dict[str, Any], place: Path) -> None:
    """Refuse what a file of results names on this machine, unless a run of this user named it.

    Args:
        received: a scenario, or what holds some, as read from the file `place`.
        place: the file, or the folder of its run.

    Raises:
        UnknownCode: naming the code or file, and the option that trusts the folder.
    """
    named = dict(_named(msgspec.to_builtins(received)))
    if set(named.values()) <= _known:
        return
    own, whole = _known | _own_list(), place.resolve()
    if any(whole.is_relative_to(folder) for folder in _trusted):
        return
    folder = place if place.is_dir() else place.parent
    for name, mark in named.items():
        if mark not in own:
            kind = "the code of" if is_source_name(name) else "the file"
            raise UnknownCode(
                f"{place}: names {kind} {name!r}, which no run of yours has named; look into it, "
                f"and add --trust {folder} if it may be used here"
            )


def _named(value: Any) -> Iterator[tuple[str, str]]:
    """Yield each file or module that a plain value names, with its mark in the user's list."""
    match value:
        case {"source": str(source), "digest": str(digest), **others} if source:
            yield from _marked(f"{source}#{digest}" if digest else source)
            yield from _named(others)
        case dict():
            # A folder of recorded data is the one path without a word before it.
            paths = value.get("data")
            for path in [paths] if isinstance(paths, str) else paths or ():
                yield str(path), _mark(str(path))
            for name, one in value.items():
                yield from _marked(str(name))
                yield from _named(one)
        case list() | tuple():
            for one in value:
                yield from _named(one)
        case str():
            yield from _marked(value)


def _marked(text: str) -> Iterator[tuple[str, str]]:
    for word in (text, *_WORDS.split(text)):
        name, _, digest = word.partition("#")
        if any(start in word for start in _FILES):
            yield word, _mark(word)
        elif is_source_name(word) and not name.startswith("session:"):
            # The import of a module runs its packages too, so that its name counts.
            is_file = name.rpartition(":")[0].endswith(".py")
            yield name, digest if digest and is_file else _mark(word)


def _mark(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _list_file() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "concord" / "own_files"


def _own_list() -> set[str]:
    try:
        return set(_list_file().read_text(encoding="ascii").split())
    except (OSError, ValueError, RuntimeError):
        return set()
