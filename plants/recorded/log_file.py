"""Interface of the readers of log files: series of numbers by name, and their stamps."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np

Read = TypeVar("Read")


class LogFile(ABC):
    """Series of a file.

    An error of its methods names the series; the caller names the file.

    Attributes:
        names: of the series.
        unread: names of what the file holds and the reader cannot decode.
    """

    names: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()

    @abstractmethod
    def series(self, name: str) -> np.ndarray:
        """Return the numbers (n,) of a series, NaN for an empty one.

        Raises:
            ValueError: for an entry that is not a number.
        """

    @abstractmethod
    def stamps_s(self, name: str) -> np.ndarray | None:
        """Return the stamps (n,) of a series, or None where the file does not tell them."""

    @property
    def stamping(self) -> tuple[str, ...]:
        """Series that only stamp others."""
        return ()

    def unit(self, name: str) -> str | None:
        """Return the unit that the file gives for a series, or None where it gives none."""
        del name

    def place(self, row: int) -> str:
        """Return how an error names an entry of a series, counted from 0."""
        return f"reading {row + 1}"


@cache  # several parts of a run read one log, and a line is said once
def say(line: str) -> None:
    """Write a line about a log to the standard error."""
    sys.stderr.write(f"{line}\n")


def while_files_stay(read: Callable[[str], Read]) -> Callable[[str], Read]:
    """Return a function of a log, a file or a folder, that reads again only a log that changed."""
    cached = cache(lambda data, _files: read(data))

    def read_once(data: str) -> Read:
        path = Path(data)
        files = path.glob("*") if path.is_dir() else [path] * path.is_file()
        stats = {one.name: one.stat() for one in files}
        return cached(data, tuple((n, at.st_mtime_ns, at.st_size) for n, at in stats.items()))

    return read_once
