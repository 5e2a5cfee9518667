"""The smoothed past of a window: beliefs of its steps given all records that a lane holds."""

import numpy as np

from concord.filters.extended import ExtendedFilter
from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.filters.iterated import IteratedFilter
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented
from concord.filters.smoother import Backward, backward, backward_affine, smooth
from concord.filters.square_root import SquareRootFilter
from concord.nodes.rules.labelled.window_filter import WindowFilter, Windows
from concord.nodes.rules.local_filter import Model, transition_of, with_state_noise


def way_back(
    beliefs: Gaussian, control: np.ndarray | None, step: int, model: Model, filter: Filter
) -> Backward:
    """The way from `step`, into which `control` drove, back to beliefs (..., n) of the step before.

    An extended filter goes back by its tangent. Other filters use their sigma points, or the usual
    ones where they have none.
    """
    noise_cov = with_state_noise(model.process_noise_cov(step - 1), model, beliefs, step - 1)
    transition = transition_of(model, control, step - 1)
    n = beliefs.mean.shape[-1]
    while isinstance(filter, IteratedFilter):
        filter = filter.inner
    if isinstance(filter, ExtendedFilter):
        tangent = filter.linearise(beliefs, transition, n, np.subtract)
        return backward_affine(beliefs, tangent, noise_cov)
    return backward(beliefs, transition, noise_cov, _points(filter, n))


def _points(filter: Filter, states: int) -> SigmaPointRule:
    has_points = isinstance(filter, SigmaPointFilter | SquareRootFilter)
    return filter.rule if has_points else scaled_unscented(states)


def smoothed_past(filter: WindowFilter, windows: Windows, most: int) -> Gaussian:
    """The states of the last steps given all records: mean (R, M, most + 1, n) and covariance.

    Entry l is the state of l steps ago, and entry 0 the newest posterior; NaN before the window's
    first step. The windows are filtered.
    """
    newest = len(windows.controls) - 1
    oldest = max(newest - most, windows.first)
    history = Gaussian(*(np.moveaxis(one[:, :, oldest:], 2, 0) for one in windows.posteriors))
    ways = []
    for place in range(oldest, newest):
        control, step = windows.controls[place + 1], windows.step_at(place + 1)
        driven = None if control is None else control[:, None]
        before = Gaussian(*(one[:, :, place] for one in windows.posteriors))
        ways.append(way_back(before, driven, step, filter.model, filter.filter))
    found = [np.moveaxis(one[::-1], 0, 2) for one in smooth(history, ways)]
    lacking = most - len(ways)
    return Gaussian(*(_padded(one, lacking) for one in found))


def _padded(values: np.ndarray, lacking: int) -> np.ndarray:
    """Values (R, M, L, ...) with so many more that are NaN."""
    shape = (*values.shape[:2], lacking, *values.shape[3:])
    return np.concatenate((values, np.full(shape, np.nan)), axis=2)
