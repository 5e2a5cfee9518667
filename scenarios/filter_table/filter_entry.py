"""A filter of the nodes as the table of filters has it."""

from collections.abc import Callable
from typing import Any, NamedTuple

from concord.filters.filter import Filter
from concord.filters.sigma_points import SigmaPointRule


class FilterEntry(NamedTuple):
    """A filter of the table.

    Attributes:
        build: (its value in the scenario, the scenario's sigma points) -> the filter.
        linear: serves only plants and sensors that are linear.
        singular: takes covariances without an inverse.
        robust: departs from the Kalman filter on linear models, on purpose.
        models: number of models of a belief.
    """

    build: Callable[[Any, SigmaPointRule], Filter]
    linear: bool = False
    singular: bool = False
    robust: bool = False
    models: int = 1
