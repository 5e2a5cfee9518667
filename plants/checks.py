"""Refusals that every plant shares."""

import math


def require_positive(**values: float) -> None:
    """Raises ValueError for the first value that is not above 0 and finite, by its name."""
    for name, value in values.items():
        if not 0 < value < math.inf:
            raise ValueError(f"{name} is {value}, but must be above 0 and finite; change {name}")
