"""Filters as values: how a node computes its estimate from readings."""

from concord.scenarios.types.option import Choice


class FilterBase(Choice, frozen=True, kw_only=True):
    """A filter of the nodes."""


class UnscentedFilter(FilterBase, frozen=True, kw_only=True, tag="ukf"):
    """Unscented Kalman filter."""


class RecommendedFilter(FilterBase, frozen=True, kw_only=True, tag="recommended"):
    """Unscented filter with exact moments of noise that grows with the state (meng2025)."""


FilterChoice = UnscentedFilter | RecommendedFilter
