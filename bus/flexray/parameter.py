"""A parameter of the FlexRay specification: its name there, and its range."""

from typing import NamedTuple


class Parameter(NamedTuple):
    """A parameter's name in the specification, and its range (both ends belong to it)."""

    standard_name: str
    low: int
    high: int
