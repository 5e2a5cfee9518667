"""Logs in text: rows of fields, as spreadsheets, loggers and `rostopic` write them."""

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from concord.plants.recorded.log_file import LogFile
from concord.plants.recorded.units import UNITS, unit_of

_COMMENTS = ("#", "%")
_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?)?)\s*(?:Z|([+-])(\d\d):?(\d\d)?)?"
)
"""An ISO 8601 date; sign, hours and minutes of its zone."""
_MISSING = frozenset({"", "-", "nil", "na", "n/a", "nan", "null", "none"})


class _Row(NamedTuple):
    line: int
    fields: list[str]


class CsvFile(LogFile):
    """UTF-8 text: a line of column names, perhaps one of units, then a line for each moment.

    Fields stand between commas, semicolons or tabs. Between semicolons or tabs a number may have a
    decimal comma. Lines that begin with `#` or `%` are comments; the last before the numbers holds
    the names where no other line does. Empty fields, `nil`, `NA`, `NaN`, `null` and `-` are NaN.
    A column of ISO 8601 dates is one of seconds since 1970, in UTC where the date has no zone.
    """

    def __init__(self, file: Path) -> None:
        """Read the file.

        Raises:
            ValueError: it cannot be read, or has no line of names.
        """
        lines = [_Row(n, [line]) for n, line in enumerate(text_of(file).splitlines(), 1)]
        lines = [row for row in lines if row.fields[0].strip(" ,;\t")]
        plain = [row for row in lines if not row.fields[0].lstrip().startswith(_COMMENTS)]
        sign = max(",;\t", key=plain[0].fields[0].count) if plain else ","
        rows = _split(plain, sign)
        if rows and _is_data(rows[0]):
            comments = _split([row for row in lines if row.line < rows[0].line], sign)
            heads = [row for row in comments if len(row.fields) == len(rows[0].fields)]
            if not heads:
                raise ValueError(
                    f"{file}: line {rows[0].line} holds numbers, and no line above it the names "
                    "of the columns; write them there, with the same separator"
                )
            rows.insert(0, _Row(heads[-1].line, [one.lstrip(" #%") for one in heads[-1].fields]))
        self._rows = rows[1:]
        self._decimal_comma = sign != ","
        self.names = tuple(name.strip() for name in rows[0].fields) if rows else ()
        self._units = self._rows.pop(0) if self._rows and _is_units(self._rows[0]) else None

    def series(self, name: str) -> np.ndarray:
        """Return the numbers (n,) of a column; dates in seconds."""
        texts = self._texts(name)
        number = _seconds if _is_dated(texts) else float
        if self._decimal_comma and not any("." in text for text in texts):
            texts = [text.replace(",", ".") for text in texts]
        values = np.empty(len(texts))
        for place, text in enumerate(texts):
            try:
                values[place] = math.nan if text.lower() in _MISSING else number(text)
            except ValueError:
                wanted = "an ISO 8601 date" if number is _seconds else "a number"
                raise ValueError(
                    f"{self.place(place)}: field {self.names.index(name) + 1} ({name}) is "
                    f"{text[:40]!r}, which is not {wanted}; write one, or leave the field empty"
                ) from None
        return values

    def stamps_s(self, name: str) -> None:
        """Return None: the column map names the column of the stamps."""

    def unit(self, name: str) -> str | None:
        """Return the unit of the line of units, s for dates, None for neither."""
        if _is_dated(self._texts(name)):
            return "s"
        place = self.names.index(name)
        fields = self._units.fields if self._units else []
        unit = unit_of(fields[place]) if place < len(fields) else ""
        return None if unit.lower() in _MISSING else unit

    def place(self, row: int) -> str:
        """Return the line of a row."""
        return f"line {self._rows[row].line}"

    def _texts(self, name: str) -> list[str]:
        place = self.names.index(name)
        for row in self._rows:
            if len(row.fields) <= place:
                raise ValueError(
                    f"line {row.line} has {len(row.fields)} fields and none for {name!r}, field "
                    f"{place + 1}; complete the line, or remove it"
                )
        return [row.fields[place].strip() for row in self._rows]


def _split(lines: Sequence[_Row], sign: str) -> list[_Row]:
    """Return the fields of lines; a quoted field may go on in the next line."""
    reader = csv.reader((row.fields[0] for row in lines), delimiter=sign)
    return [_Row(lines[reader.line_num - 1].line, fields) for fields in reader]


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text.replace(",", ".")))
    except ValueError:
        return _is_dated([text])


def _is_data(row: _Row) -> bool:
    """Whether every field is a number, a date or missing."""
    return all(one.strip().lower() in _MISSING or _is_number(one) for one in row.fields)


def _is_units(row: _Row) -> bool:
    """Whether some field is a unit, and none a number."""
    known = any(unit_of(one) in UNITS for one in row.fields)
    return known and not any(_is_number(one) for one in row.fields)


def _is_dated(texts: Sequence[str]) -> bool:
    first = next((text for text in texts if text.lower() not in _MISSING), "")
    try:
        return "-" in first[1:] and _seconds(first) is not None
    except ValueError:
        return False


def _seconds(text: str) -> float:
    found = _DATE.fullmatch(text.strip())
    if found is None:
        raise ValueError("no ISO 8601 date")
    moment, sign, hours, minutes = found.groups()
    ahead_s = int(f"{sign or ''}1") * (3600 * int(hours or 0) + 60 * int(minutes or 0))
    return np.datetime64(moment, "ns").astype(np.int64) / 1e9 - ahead_s


def text_of(file: Path) -> str:
    """Return the text of a UTF-8 file, less its byte order mark.

    Raises:
        ValueError: it cannot be read, or is not UTF-8.
    """
    try:
        return file.read_text(encoding="utf-8-sig")  # some programs begin a file with its mark
    except OSError as error:
        why = f"cannot be read ({error.strerror})"
        raise ValueError(f"{file}: {why}; name one that is there") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{file}: byte {error.start} is not UTF-8 text; save the file as UTF-8"
        ) from None
