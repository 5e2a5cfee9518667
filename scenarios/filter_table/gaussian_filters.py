"""The filters of Gaussian beliefs that the core has."""

from concord.filters.extended import ExtendedFilter
from concord.filters.interacting_models import InteractingModels, Mode
from concord.filters.iterated import IteratedFilter
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import SigmaPointRule, cubature
from concord.filters.square_root_filter import SquareRootFilter
from concord.scenarios.filter_table.filter_entry import FilterEntry
from concord.scenarios.types.filters import InteractingMultipleModels

_EXACT_STEP = 1.0
"""Step of the differences of an affine model, in standard deviations: the larger the more exact."""


def _straight_and_turning(
    choice: InteractingMultipleModels, points: SigmaPointRule
) -> InteractingModels:
    states = points.unit_points.shape[1]
    # The rate of turn is the last state.
    straight = Mode(held=(states - 1,), std=choice.turn_rate_std)
    return InteractingModels(SigmaPointFilter(points), states, (straight, Mode()), choice.change)


def _cubature(points: SigmaPointRule) -> SigmaPointRule:
    return cubature(points.unit_points.shape[1])


UKF = FilterEntry(lambda _, points: SigmaPointFilter(points))
CKF = FilterEntry(lambda _, points: SigmaPointFilter(_cubature(points)))
SRUKF = FilterEntry(lambda _, points: SquareRootFilter(points))
SRCKF = FilterEntry(lambda _, points: SquareRootFilter(_cubature(points)))
EKF = FilterEntry(lambda _, points: ExtendedFilter(), singular=True)
KF = FilterEntry(lambda _, points: ExtendedFilter(_EXACT_STEP), linear=True, singular=True)
IPLF = FilterEntry(
    lambda choice, points: IteratedFilter(SigmaPointFilter(points), choice.iterations)
)
IEKF = FilterEntry(
    lambda choice, _: IteratedFilter(ExtendedFilter(), choice.iterations), singular=True
)
IMM = FilterEntry(_straight_and_turning, robust=True, models=2)
