"""Interface of the readers of log files: series of numbers by name, and their stamps."""

import sys
from abc import ABC, abstractmethod
from functools import cache

import numpy as np


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
