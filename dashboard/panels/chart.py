"""A chart as a value: a name, a unit, and lines that know how to take their column from frames."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from concord.dashboard.frames.expected import Expected
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.stage import Stage
from concord.dashboard.theme import Colour, Theme
from concord.dashboard.view import View


class Sample(NamedTuple):
    """The frames that charts show, their times (T,) in seconds, and the expectation at them."""

    stage: Stage
    view: View
    frames: Sequence[StepFrame]
    times: np.ndarray
    expected: Expected


Column = Callable[[Sample], np.ndarray]
"""(sample) -> the values (T,) of a line; NaN where a value is unknown."""


class Line(NamedTuple):
    """A named line of a chart, with its colour in each theme."""

    name: str
    colour: Callable[[Theme], Colour]
    column: Column
    dashed: bool = False


class Chart(NamedTuple):
    """A chart of quantities over time.

    `from_zero` keeps zero in sight, unless a peak asks for a logarithmic scale. `about` returns
    name and unit where they depend on the view.
    """

    name: str
    unit: str
    lines: tuple[Line, ...]
    from_zero: bool = True
    about: Callable[[Sample], tuple[str, str]] | None = None


def of_frames(value: Callable[[StepFrame], float]) -> Column:
    """Return the column with one value of each frame."""
    return lambda sample: np.array([value(frame) for frame in sample.frames], dtype=np.float64)


def known_pieces(values: np.ndarray) -> list[slice]:
    """Return the runs of known values (T,), between which a line has gaps."""
    known = np.r_[False, np.isfinite(values), False].astype(int)
    begins, ends = np.flatnonzero(np.diff(known) > 0), np.flatnonzero(np.diff(known) < 0)
    return [slice(int(a), int(b)) for a, b in zip(begins, ends, strict=True)]


class Curve(NamedTuple):
    """A line with the colour and the values (T,) that a page shows."""

    name: str
    colour: Colour
    dashed: bool
    values: np.ndarray


class Drawn(NamedTuple):
    """A chart as a page shows it: its title with the unit, times (T,) in seconds, curves."""

    title: str
    times: np.ndarray
    curves: tuple[Curve, ...]
    is_logarithmic: bool = False
