"""A JSON file that holds a described type."""

from pathlib import Path
from typing import TypeVar

import msgspec

from concord.disk import whole_file
from concord.nodes.bounds import UNREADABLE

T = TypeVar("T")


def read_json(path: Path, kind: type[T], cure: str, wrong: str) -> T:
    """Return the value of a type that a JSON file holds.

    Raises:
        ValueError: the file cannot be read, with the cure; or it holds something else, what is
            wrong.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); {cure}") from None
    except UNREADABLE as error:
        raise ValueError(f"{path}: {wrong} ({error})") from None


def write_json(path: Path, value: object) -> None:
    """Write a value as indented JSON, whole or not at all.

    Raises:
        NotWritten: the file cannot be written.
    """
    with whole_file(path) as unfinished:
        unfinished.write_bytes(msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n")
