"""Filters that learn the noise of their sensors, and one that resists outliers.

Reason for a file of its own: entries name it.
"""

from concord.features.vehicle.adaptive.adaptive_filter import AdaptiveFilter
from concord.features.vehicle.adaptive.correntropy import CorrentropyFilter
from concord.features.vehicle.adaptive.dual_layer import DualLayerFilter
from concord.features.vehicle.adaptive.fuzzy_noise import FuzzyMatching
from concord.features.vehicle.adaptive.sage_husa import Bounds, SageHusa
from concord.features.vehicle.options import FuzzyUnscented, SageHusaBase
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.scenarios.filter_table.filter_entry import FilterEntry
from concord.scenarios.types.filters import NoiseLearningFilter


def _bounds(choice: NoiseLearningFilter) -> Bounds:
    return Bounds(choice.least_noise, choice.most_noise)


def _sage_husa(choice: SageHusaBase) -> SageHusa:
    return SageHusa(choice.forgetting, _bounds(choice), choice.outlier_limit)


def _fuzzy(choice: FuzzyUnscented) -> FuzzyMatching:
    return FuzzyMatching(choice.innovations, _bounds(choice))


MCUKF = FilterEntry(
    lambda choice, points: CorrentropyFilter(points, choice.bandwidth, choice.iterations),
    robust=True,
)
AUKF = FilterEntry(
    lambda choice, points: AdaptiveFilter(SigmaPointFilter(points), _sage_husa(choice), points)
)
FAUKF = FilterEntry(
    lambda choice, points: AdaptiveFilter(SigmaPointFilter(points), _fuzzy(choice), points)
)
ADLUKF = FilterEntry(
    lambda choice, points: AdaptiveFilter(DualLayerFilter(points), _sage_husa(choice), points)
)
