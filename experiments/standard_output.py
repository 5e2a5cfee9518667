"""Standard output that cannot be written: a closed pipe, a full disk, a character that it lacks."""

import codecs
import io
import os
import signal
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from concord.disk import NotWritten

if TYPE_CHECKING:
    from rich.console import Console

BROKEN_PIPE = 128 + signal.SIGPIPE
_PLAIN = {
    "±": "+-", "×": "x", "√": "sqrt ", "²": "^2", "°": "deg", "µ": "u", "≤": "<=", "≥": ">=",
    "…": ".", "•": "*", **dict.fromkeys("─━═╌╍╴╶╸╺", "-"), **dict.fromkeys("│┃║", "|"),
}  # fmt: skip
_LINES = range(0x2500, 0x2580)  # the block of characters of which tables and boxes are drawn


def prepare_streams() -> None:
    """Let standard output and error take everything.

    A stream that was closed before the start writes to nowhere. A stream whose encoding lacks a
    character writes it by others.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            # The lowest free descriptor is the closed one, so no file of a run gets its number.
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="concord")


def plain_console(file_width: int | None = None) -> "Console":
    """Return a console that prints names as they are: no markup, emoji or coloured numbers.

    A file or a pipe, which has no width to keep to, gets `file_width` characters.
    """
    # Only here: help and errors do without it.
    from rich.console import Console

    plain = partial(Console, markup=False, emoji=False, highlight=False)
    console = plain()
    return console if console.is_terminal or file_width is None else plain(width=file_width)


@contextmanager
def standard_output() -> Iterator[None]:
    """A command that prints; exit code 141 if its reader has gone, as after `| head`.

    Raises:
        NotWritten: a disk does not take it.
    """
    try:
        try:
            yield
        except SystemExit as ended:
            # rich ends a command whose reader has gone, with exit code 1.
            if isinstance(ended.__context__, BrokenPipeError):
                sys.exit(BROKEN_PIPE)
            raise
        finally:
            sys.stdout.flush()
    except OSError as error:
        if _taken():
            raise
        # The rest of the buffer cannot be written, and Python must not try it again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            sys.exit(BROKEN_PIPE)
        raise NotWritten(Path("standard output"), error) from error


def _taken() -> bool:
    """Return whether standard output is well: the error does not say which file it is about."""
    try:
        os.write(sys.stdout.fileno(), b"\n")
    except io.UnsupportedOperation:
        return True
    except OSError:
        return False
    return True


def _in_plain_characters(error: UnicodeError) -> tuple[str, int]:
    """Return ASCII characters for those that an encoding lacks, and where to go on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_plain, error.object[error.start : error.end])), error.end


def _plain(character: str) -> str:
    if character in _PLAIN:
        return _PLAIN[character]
    if ord(character) in _LINES:
        return "+"
    name = unicodedata.name(character, "")
    if name.startswith("GREEK"):
        letter = name.rpartition(" ")[2]
        return letter.title() if "CAPITAL" in name else letter.lower()
    return unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode() or "?"


codecs.register_error("concord", _in_plain_characters)
