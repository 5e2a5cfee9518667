"""Files of logs, read in one way: series of numbers by name, and their stamps."""

import csv
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from concord.plants.recorded.dataset_files import DatasetFile
from concord.plants.recorded.mcap_files import McapFile
from concord.plants.recorded.ulog_files import ULogFile


class LogFile(Protocol):
    """Series of a file.

    An error of its methods names the series; the caller names the file.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the series."""
        ...

    def series(self, name: str) -> np.ndarray:
        """Return the numbers (n,) of a series, NaN for an empty one.

        Raises:
            ValueError: for an entry that is not a number.
        """
        ...

    def stamps_s(self, name: str) -> np.ndarray | None:
        """Return the stamps (n,) of a series, or None where the file does not tell them."""
        ...


class CsvFile:
    """UTF-8 text: a line of column names, then numbers, commas between; an empty field is NaN."""

    def __init__(self, file: Path) -> None:
        """Read the file.

        Raises:
            ValueError: it cannot be read, or has no commas.
        """
        rows = list(csv.reader(text_of(file).splitlines()))
        self.names = tuple(name.strip() for name in rows[0]) if rows else ()
        self._rows = rows[1:]
        if len(self.names) == 1 and any(sign in self.names[0] for sign in ";\t"):
            raise ValueError(
                f"{file}: the first line has semicolons or tabs and no comma; separate fields by "
                "commas, and write decimals with a point"
            )

    def series(self, name: str) -> np.ndarray:
        """Return the numbers (n,) of a column."""
        place = self.names.index(name)
        return np.array([_number(line, row, place) for line, row in enumerate(self._rows, 2)])

    def stamps_s(self, name: str) -> None:
        """Return None: the column map names the column of the stamps."""


def text_of(file: Path) -> str:
    """Return the text of a UTF-8 file, less its byte order mark.

    Raises:
        ValueError: it cannot be read, or is not UTF-8.
    """
    try:
        return file.read_text(encoding="utf-8-sig")  # some programs begin a file with its mark
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror}); a log needs it") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{file}: byte {error.start} is not UTF-8 text; save the file as UTF-8"
        ) from None


def _number(line: int, row: list[str], place: int) -> float:
    try:
        return float(row[place]) if row[place].strip() else math.nan
    except (IndexError, ValueError):
        raise ValueError(
            f"line {line}: field {place + 1} of {','.join(row)[:60]!r} is not a number; "
            "write one (of stamps: of seconds), or leave the field empty"
        ) from None


READERS: Mapping[str, Callable[[Path], LogFile]] = {
    ".csv": CsvFile,
    ".nc": DatasetFile,
    ".mcap": McapFile,
    ".ulg": ULogFile,
}
"""Reader of a file by the end of its name."""


def open_log(file: Path) -> LogFile:
    """Return the series of a file.

    Raises:
        ValueError: naming the file, for one that cannot be read or ends in no known way.
    """
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise ValueError(f"{file}: a log is read from files that end in {', '.join(READERS)}")
    return reader(file)
