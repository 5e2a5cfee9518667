"""A filter of the nodes as the table of filters has it."""

from collections.abc import Callable
from typing import Any, NamedTuple

from concord.filters.extended import ExtendedFilter
from concord.filters.filter import Filter
from concord.filters.iterated import IteratedFilter
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import SigmaPointRule, cubature
from concord.filters.square_root import SquareRootFilter
from concord.scenarios.types.filters import InteractingMultipleModels


class FilterEntry(NamedTuple):
    """A filter of the table.

    Attributes:
        build: (its value in the scenario, the scenario's sigma points) -> the filter.
        linear: serves only plants and sensors that are linear.
        singular: takes beliefs whose covariance has no inverse.
        square_root: takes readings however small their noise, in square-root form.
        robust: departs from the Kalman filter on linear models, on purpose.
        models: number of models of a belief.
    """

    build: Callable[[Any, SigmaPointRule], Filter]
    linear: bool = False
    singular: bool = False
    square_root: bool = False
    robust: bool = False
    models: int = 1


_EXACT_STEP = 1.0
"""Step of the differences of an affine model, in standard deviations: the larger the more exact."""


def _straight_and_turning(choice: InteractingMultipleModels, points: SigmaPointRule) -> Filter:
    # Only here: most nodes filter one model.
    from concord.filters.interacting_models import InteractingModels, Mode

    states = points.unit_points.shape[1]
    # The rate of turn is the last state.
    straight = Mode(held=(states - 1,), std=choice.turn_rate_std)
    return InteractingModels(SigmaPointFilter(points), states, (straight, Mode()), choice.change)


def _cubature(points: SigmaPointRule) -> SigmaPointRule:
    return cubature(points.unit_points.shape[1])


UKF = FilterEntry(lambda _, points: SigmaPointFilter(points), square_root=True)
CKF = FilterEntry(lambda _, points: SigmaPointFilter(_cubature(points)), square_root=True)
SRUKF = FilterEntry(lambda _, points: SquareRootFilter(points), square_root=True)
SRCKF = FilterEntry(lambda _, points: SquareRootFilter(_cubature(points)), square_root=True)
EKF = FilterEntry(lambda _, points: ExtendedFilter(), singular=True)
KF = FilterEntry(lambda _, points: ExtendedFilter(_EXACT_STEP), linear=True, singular=True)
IPLF = FilterEntry(
    lambda choice, points: IteratedFilter(SigmaPointFilter(points), choice.iterations)
)
IEKF = FilterEntry(
    lambda choice, _: IteratedFilter(ExtendedFilter(), choice.iterations), singular=True
)
IMM = FilterEntry(_straight_and_turning, robust=True, models=2)
