"""Values that `concord identify` finds, as one word and as a file of TOML.

| name | value |
|---|---|
| R.gps | factor of the standard deviation of the noise of a kind of sensor |
| Q.speed | factor of the standard deviation of the process noise of a state |
| delay.imu | by how many s the stamps of a sensor are late |
| theta.mass | a parameter that the plant declares |

The word is "R.gps=1.5;theta.mass=1450"; the file has a table for each of R, Q, delay and theta.
"""

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

R, Q, DELAY, THETA = TABLES = ("R", "Q", "delay", "theta")
_SUFFIX = ".toml"


def in_one_word(asked: str) -> str:
    """The values of a file or of a word, as the word for them.

    Raises:
        ValueError: a file that cannot be read, a value that is no number, a factor of 0 or less.
    """
    if not asked.endswith(_SUFFIX):
        return word_of(values_in(asked))
    try:
        tables = tomllib.loads(Path(asked).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise ValueError(
            f"--identified {asked}: cannot be read ({why}); give a file of `concord identify`"
        ) from None
    pairs = {
        f"{table}.{name}": value
        for table, values in tables.items()
        for name, value in (values.items() if isinstance(values, dict) else [("", values)])
    }
    return word_of(_checked(pairs, asked))


def values_in(word: str) -> dict[str, float]:
    """The values of a word by name.

    Raises:
        ValueError: as `in_one_word`.
    """
    pairs = (one.partition("=") for one in word.split(";") if one)
    return _checked({name.strip(): value for name, _, value in pairs}, word)


def _checked(pairs: Mapping[str, Any], asked: str) -> dict[str, float]:
    found = {}
    for name, given in pairs.items():
        table = name.partition(".")[0]
        try:
            found[name] = float(given)
        except (TypeError, ValueError):
            found[name] = np.nan
        is_factor = table in (R, Q)
        if table not in TABLES or not np.isfinite(found[name]) or (is_factor and found[name] <= 0):
            raise ValueError(
                f"--identified {asked}: {name}={given}; write NAME=NUMBER, such as R.gps=1.5, "
                "Q.speed=0.3 (factors above 0), delay.imu=0.02 or theta.mass=1450"
            )
    return found


def word_of(values: Mapping[str, float]) -> str:
    """The word for values by name."""
    return ";".join(f"{name}={float(value)!r}" for name, value in sorted(values.items()))


def in_toml(values: Mapping[str, float], notes: Mapping[str, str]) -> str:
    """The file for values by name, with a note beside each; notes of other names are comments."""
    lines = ["# Written by `concord identify`; concord takes it with --identified FILE."]
    for table in TABLES:
        every = sorted({*values, *notes})
        of_table = [name for name in every if name.startswith(f"{table}.")]
        lines += ["", f"[{table}]"] if of_table else []
        for name in of_table:
            key, note = json.dumps(name.partition(".")[2]), notes.get(name, "")
            value = f"{key} = {float(values[name])!r}" if name in values else f"# {key}"
            lines.append(f"{value}  # {note}" if note else value)
    return "\n".join(lines) + "\n"
