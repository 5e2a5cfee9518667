"""A JSON file that holds a described type."""

from pathlib import Path
from typing import TypeVar

import msgspec

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
    except msgspec.MsgspecError as error:
        raise ValueError(f"{path}: {wrong} ({error})") from None
