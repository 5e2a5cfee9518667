"""Specification of a sweep: fields of a scenario with several values each, and their cells."""

import hashlib
import itertools
import math
import re
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import offered_options, scenario_with_known
from concord.scenarios.types.assignment import flat, refuse_left
from concord.scenarios.user.values import is_source_name, source_of
from concord.topology.names import unknown_name

Value = str | float | int | bool | None
# Runs are numbered by the sweep itself.
FIELDS = {name: option for name, option in offered_options().items() if name != "run"}
_TRUE, _FALSE = ("true", "yes"), ("false", "no")
_NO_CHANGES = "none"


class Range(msgspec.Struct, frozen=True):
    """All numbers from `low` to `high`, both included; whole ones if `whole`."""

    low: float
    high: float
    whole: bool


class Specification(msgspec.Struct, frozen=True, kw_only=True):
    """A sweep. Equal specifications give equal results, whatever computes them.

    Attributes:
        base: fields with one value.
        levels: fields with several, in the order in which they were named.
        runs: Monte-Carlo runs of each cell; run r has the same noise in every cell of one seed.
        samples: cells of a Latin hypercube; None for every combination.
        change_step: the step from which convergence is timed.
        keep: "histories" of every step of a run, "figures" of every run, or "moments" over runs.
        digests: of the files that values come from (FILE.py:NAME), and of folders of recorded data.
        exact: figures are expectations over the noise; a run is a pattern of losses.
    """

    base: dict[str, Value]
    levels: dict[str, list[Value]]
    ranges: dict[str, Range] = {}
    runs: int = 20
    samples: int | None = None
    change_step: int = 0
    keep: str = "histories"
    digests: dict[str, str] = {}
    exact: bool = False

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Return the swept fields."""
        return (*self.levels, *self.ranges)


class Cell(typing.NamedTuple):
    """One combination: its place in the sweep, the values of the swept fields, and all of it."""

    number: int
    values: dict[str, Value]
    scenario: Scenario

    @property
    def name(self) -> str:
        """Return the cell in the words of its swept fields."""
        return named(self.values)


def named(values: Mapping[str, object]) -> str:
    """Values of swept fields in words."""
    return ", ".join(f"{field}={shown(value)}" for field, value in values.items()) or "all"


def shown(value: object) -> str:
    """A value as a user would write it."""
    if isinstance(value, float | np.floating):
        return f"{value:g}"
    return str(value)


def specify(
    asked: Mapping[str, str],
    *,
    runs: int = 20,
    samples: int | None = None,
    change_step: int = 0,
    exact: bool = False,
) -> Specification:
    """Return the sweep that options say: comma lists of values, or low..high, by field.

    Raises:
        ValueError: an unknown field, a value that its field cannot have, or a value twice.
    """
    _require(runs >= 1, f"--runs {runs}: must be at least 1")
    _require(change_step >= 0, f"--change-step {change_step}: must be 0 or more")
    _require(
        samples is None or samples >= 2, f"--latin-hypercube {samples}: must be at least 2 cells"
    )
    base: dict[str, Value] = {}
    levels: dict[str, list[Value]] = {}
    ranges: dict[str, Range] = {}
    for field, text in asked.items():
        if field not in FIELDS:
            raise unknown_name("field", field, FIELDS)
        between = _range(field, text)
        if between is not None and samples is not None:
            ranges[field] = between
            continue
        values = _whole(field, text, between) if between else _listed(field, text)
        if len(values) == 1:
            base[field] = values[0]
        else:
            levels[field] = values
    _require(
        samples is None or bool(levels or ranges),
        f"--latin-hypercube {samples}: nothing is swept; give a field several values (ring,path) "
        "or a range (0.1..1)",
    )
    named = [value for values in (base.values(), *levels.values()) for value in values]
    digests = {str(name): source_of(str(name)).digest for name in named if is_source_name(name)}
    folders = [str(value) for value in (base.get("data"), *levels.get("data", ())) if value]
    digests |= {folder: _digest_of_folder(Path(folder)) for folder in folders}
    return Specification(
        base=base, levels=levels, ranges=ranges, runs=runs, samples=samples,
        change_step=change_step, digests=digests, exact=exact,
    )  # fmt: skip


def _digest_of_folder(folder: Path) -> str:
    """Return the digest of the names and contents of the files of a folder, "" where it is none."""
    if not folder.is_dir():
        return ""
    digest = hashlib.sha256()
    for file in sorted(one for one in folder.iterdir() if one.is_file()):
        with file.open("rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
        digest.update(f"{file.name} {content}\n".encode())
    return digest.hexdigest()[:16]


def cells_of(specification: Specification) -> list[Cell]:
    """Return the cells, the last field fastest; their scenarios are complete but not yet checked.

    Raises:
        ValueError: a scenario of an unknown name, or without its data, or an option that no cell
            has.
    """
    combinations = _sampled(specification) if specification.samples else _factorial(specification)
    cells: list[Cell] = []
    used: set[str] = set()
    unused: dict[str, tuple[Scenario, Any]] = {}
    for number, values in enumerate(combinations):
        asked: dict[str, Any] = {**specification.base, **values}
        if "changes" in asked:
            asked["changes"] = _changes(str(asked["changes"]))
        # An option of one rule is left out of the cells of the others.
        scenario, left = scenario_with_known(**asked)
        used |= flat(scenario).keys()
        unused |= {name: (scenario, value) for name, value in left.items()}
        cells.append(Cell(number, values, scenario))
    for name, (scenario, value) in unused.items():
        if name not in used:
            refuse_left(scenario, {name: value})
    return cells


def _changes(text: str) -> tuple[str, ...]:
    """Return the changes of one cell: a comma ends the cell, so semicolons separate the lines."""
    return () if text == _NO_CHANGES else tuple(line.strip() for line in text.split(";"))


def _factorial(specification: Specification) -> list[dict[str, Value]]:
    levels = specification.levels
    return [
        dict(zip(levels, values, strict=True)) for values in itertools.product(*levels.values())
    ]


def _sampled(specification: Specification) -> list[dict[str, Value]]:
    """A Latin hypercube: each field's values are spread evenly over the cells."""
    from scipy.stats import qmc

    assert specification.samples is not None
    seed = specification.base.get("seed", 1)
    # The design is random too, and follows from the seed; a swept seed leaves it at 1.
    generator = np.random.default_rng(np.random.SeedSequence(_number(seed), spawn_key=(0x5EE9,)))
    sampler = qmc.LatinHypercube(d=len(specification.dimensions), rng=generator)
    cells = []
    for row in sampler.random(specification.samples):
        places = dict(zip(specification.dimensions, row.tolist(), strict=True))
        values: dict[str, Value] = {
            field: of[min(int(places[field] * len(of)), len(of) - 1)]
            for field, of in specification.levels.items()
        }
        values |= {field: _within(of, places[field]) for field, of in specification.ranges.items()}
        cells.append(values)
    return cells


def _number(value: Value) -> int:
    return value if isinstance(value, int) else 1


def _within(between: Range, place: float) -> Value:
    if between.whole:
        count = int(between.high - between.low) + 1
        return int(between.low) + min(int(place * count), count - 1)
    # Six digits suffice for a reader and are easy to type.
    return float(f"{between.low + place * (between.high - between.low):.6g}")


# --- what a user writes ---------------------------------------------------------------------------


def _listed(field: str, text: str) -> list[Value]:
    values = [value_of(field, part.strip()) for part in text.split(",")]
    for place, value in enumerate(values):
        if value in values[:place]:
            raise ValueError(
                f"{_option(field)} {text}: {shown(value)} is there twice; name each value once"
            )
    return values


def value_of(field: str, text: str) -> Value:
    """Return the value of a field that a text means.

    Raises:
        ValueError: it is empty, or no value of the field's type.
    """
    kinds = offered_options()[field].kinds
    if not text:
        raise ValueError(
            f"{_option(field)}: a value is empty; give one, or value,value without gaps in a sweep"
        )
    if type(None) in kinds and text.lower() in ("none", "null"):
        return None
    if bool in kinds:
        if text.lower() in (*_TRUE, *_FALSE):
            return text.lower() in _TRUE
        raise ValueError(f"{_option(field)} {text}: must be true or false")
    for kind, meaning in ((int, "a whole number"), (float, "a number")):
        if kind in kinds:
            try:
                return kind(text)
            except ValueError:
                if str in kinds:
                    return text
                raise ValueError(f"{_option(field)} {text}: must be {meaning}") from None
    return text


def _range(field: str, text: str) -> Range | None:
    kinds = FIELDS[field].kinds
    if ".." not in text or not {int, float} & set(kinds):
        return None
    if str in kinds and not re.fullmatch(r"\d+\.\.\d+", text):
        return None  # a text with dots in it, such as a path
    ends = text.split("..")
    low, high = (value_of(field, end) for end in (ends if len(ends) == 2 else (text, text)))
    assert isinstance(low, int | float) and isinstance(high, int | float)
    if not (math.isfinite(low) and low < high):
        raise ValueError(f"{_option(field)} {text}: a range must go upwards, such as 1..5")
    return Range(low, high, int in kinds)


def _whole(field: str, text: str, between: Range) -> list[Value]:
    if not between.whole:
        raise ValueError(
            f"{_option(field)} {text}: a range of any number needs --latin-hypercube N; without "
            "it name the values, such as 0.1,0.5,1"
        )
    return list(range(int(between.low), int(between.high) + 1))


def _option(field: str) -> str:
    return f"--{field.replace('_', '-')}"


def _require(holds: bool, complaint: str) -> None:
    if not holds:
        raise ValueError(complaint)
