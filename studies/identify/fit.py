"""The likeliest values of a log, their intervals, and what the log cannot tell.

Noise is sought in logarithms, as are parameters with bounds above 0. The optimiser is scipy's trust
region with the information as its curvature, so one pass over the log gives value, slopes and
curvature. A wide prior keeps it from values that nothing tells. Delays are whole steps, each by the
likelihood beside its neighbours.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.stats import t

from concord.scenarios.types.identified_values import THETA
from concord.studies.identify.likelihood import BLOCKS, DIFFERENCE, InnovationLikelihood, likelihood
from concord.studies.identify.readings import HeardReadings

COARSE_STEPS = 10_000
"""A longer log is fitted to so many of its first steps before all of them."""
MOST_PASSES = 40
"""Over the whole log."""
_SPREAD = 3.0  # of the prior of noise, in logarithms
_UNTOLD = 0.7  # standard deviation of the logarithm of noise from which nothing is told
_ENOUGH = 1e-3  # squared length of a step in standard deviations at the end
_REACH = (-8, -4, -2, -1, 1, 2, 4, 8)  # steps by which a delay is tried
_FARTHEST = 64  # steps that a delay may move in all
_LIKELY = 1.92  # half of the 95 % quantile of chi-square with one degree of freedom


class SoughtValue(NamedTuple):
    """A value that is sought, its start and its bounds. In the fit its coordinate is 0 at the
    start, and a logarithm where the bounds are above 0."""

    name: str
    start: float
    low: float
    high: float

    @property
    def is_noise(self) -> bool:
        """Whether it is a factor of noise."""
        return not self.name.startswith(f"{THETA}.")

    @property
    def _in_logarithms(self) -> bool:
        return self.low > 0

    @property
    def range(self) -> float:
        """From the least to the greatest, in the coordinate of the fit."""
        return float(np.log(self.high / self.low)) if self.low > 0 else 1.0

    @property
    def spread(self) -> float:
        """Standard deviation of the prior."""
        return _SPREAD if self.is_noise else self.range

    @property
    def untold(self) -> float:
        """Standard deviation from which the log tells nothing: 95 % are the whole range."""
        return _UNTOLD if self.is_noise else self.range / 3.92

    def value(self, at: np.ndarray | float) -> np.ndarray:
        """The values (...) at coordinates (...)."""
        if self._in_logarithms:
            return np.clip(self.start * np.exp(at), self.low, self.high)
        return np.clip(self.start + at * (self.high - self.low), self.low, self.high)


class FoundValue(NamedTuple):
    """A value after the fit, with its interval of 95 %. It stays at `before` where the log has not
    `told` it; a noise that is too small to be seen has the low end 0."""

    name: str
    before: float
    value: float
    low: float
    high: float
    told: bool


class LikeliestValues(NamedTuple):
    """The values that were found, and whether the fit came to its end."""

    found: tuple[FoundValue, ...]
    ended: bool


class Fitter:
    """The fit of some values to a log; `best` has the likeliest so far."""

    def __init__(
        self,
        log: HeardReadings,
        sought: Sequence[SoughtValue],
        delays: Sequence[str],
        start: Mapping[str, float],
        on_steps: Callable[[int], None],
    ) -> None:
        self._sought, self._delays, self._start = list(sought), list(delays), dict(start)
        kinds = {name.partition(".")[2] for name in delays}
        self._farthest = min(_FARTHEST, log.steps // 10)
        ends = max((abs(self._steps_of(name, log)) for name in delays), default=0)
        self._log = log.without_ends(kinds, self._farthest + ends) if delays else log
        self._whole, self._on_steps = self._log, on_steps
        self._at = np.zeros(len(sought))
        self._moved = dict.fromkeys(delays, 0)
        self._free = np.ones(len(sought), dtype=bool)
        self._here: InnovationLikelihood | None = None
        self._within: dict[str, tuple[int, int]] = {}

    def _steps_of(self, name: str, log: HeardReadings) -> int:
        return round(self._start.get(name, 0.0) / log.setup.time_step_s)

    def run(self) -> LikeliestValues:
        """LikeliestValues; an interrupt ends it with the best so far."""
        try:
            if self._whole.steps > 2 * COARSE_STEPS:
                self._log = self._whole.cut(COARSE_STEPS)
                self._settle()
                self._log = self._whole
            self._settle()
            self._leave_untold()
        except KeyboardInterrupt:
            return LikeliestValues(self._found(), False)
        return LikeliestValues(self._found(), True)

    def _settle(self) -> None:
        """LikeliestValues values and delays in turn, until no delay moves."""
        self._fit()
        for _ in range(4):
            if not any([self._move(name) for name in self._delays]):
                return
            self._fit()

    def _values(self, at: np.ndarray, moved: Mapping[str, Any]) -> dict[str, np.ndarray | float]:
        """All values at coordinates (..., p)."""
        step_s = self._log.setup.time_step_s
        found: dict[str, np.ndarray | float] = dict(self._start)
        for place, one in enumerate(self._sought):
            found[one.name] = one.value(at[..., place])
        for name, steps in moved.items():
            found[name] = self._start.get(name, 0.0) + steps * step_s
        return found

    def _pass(self, at: np.ndarray) -> InnovationLikelihood:
        """The likelihood with slopes by the free coordinates, prior included in none."""
        free = np.flatnonzero(self._free)
        lanes = np.tile(at, (1 + len(free), 1))
        lanes[1 + np.arange(len(free)), free] += DIFFERENCE
        return likelihood(self._log, self._values(lanes, self._moved), len(lanes), self._on_steps)

    def _prior(self) -> np.ndarray:
        spreads = [one.spread for one in self._sought]
        return 1 / np.square(np.array(spreads)[self._free])

    def _fit(self) -> None:
        """LikeliestValues the free coordinates with delays as they are."""
        free, prior = self._free, self._prior()
        passes: dict[bytes, InnovationLikelihood] = {}

        def there(part: np.ndarray) -> InnovationLikelihood:
            key = part.tobytes()
            if key not in passes:
                at = self._at.copy()
                at[free] = part
                passes[key] = self._pass(at)
            return passes[key]

        def cost(part: np.ndarray) -> tuple[float, np.ndarray]:
            found = there(part)
            value = found.value + 0.5 * float(prior @ part**2)
            return min(value, 1e300), np.nan_to_num(found.slopes + prior * part)

        def curvature(part: np.ndarray) -> np.ndarray:
            return there(part).information + np.diag(prior)

        def stop_near(part: np.ndarray) -> None:
            self._at[free], self._here = part, there(part)
            slopes = cost(part)[1]
            if slopes @ np.linalg.solve(curvature(part), slopes) < _ENOUGH:
                raise StopIteration

        start = self._at[free]
        self._here = there(start)
        if len(start):
            options = {"maxiter": MOST_PASSES, "initial_trust_radius": 1.0, "max_trust_radius": 4.0}
            minimize(
                cost, start, jac=True, hess=curvature, method="trust-exact",
                callback=stop_near, options=options,
            )  # fmt: skip

    def _move(self, name: str) -> bool:
        """Move a delay to the likeliest number of steps; return whether it moved."""
        before, known = self._moved[name], {}
        while True:
            here = self._moved[name]
            tried = [here, *(here + by for by in _REACH if abs(here + by) <= self._farthest)]
            known |= self._with_delays(name, [steps for steps in tried if steps not in known])
            self._moved[name] = min(tried, key=lambda steps: (known[steps], abs(steps)))
            if self._moved[name] == here:
                break
        likely = [steps for steps, value in known.items() if value - known[here] < _LIKELY]
        self._within[name] = min(likely), max(likely)
        return here != before

    def _with_delays(self, name: str, tried: Sequence[int]) -> dict[int, float]:
        """The likelihood of each number of steps of a delay, as lanes."""
        if not tried:
            return {}
        values = self._values(self._at, {**self._moved, name: np.array(tried)})
        found = likelihood(self._log, values, len(tried), self._on_steps, slopes=False)
        return dict(zip(tried, found.lanes.tolist(), strict=True))

    def _covs(self) -> tuple[np.ndarray, np.ndarray]:
        """Covariance (p, p) of the free coordinates: as the information has it with the prior, and
        as the scatter of the scores has it."""
        assert self._here is not None, "there was a pass"
        inverse = np.linalg.inv(self._here.information + np.diag(self._prior()))
        return inverse, inverse @ self._here.scatter @ inverse

    def _std(self) -> np.ndarray:
        """Standard deviations (p,) of all coordinates, the larger of both ways; 0 of fixed ones."""
        std = np.zeros(len(self._sought))
        if self._free.any():
            each = [np.sqrt(np.diagonal(cov)) for cov in self._covs()]
            std[self._free] = np.maximum(*each)
        return std

    def _leave_untold(self) -> None:
        """Put what the log does not tell back to its start, the least known first, and fit again.

        A value that is far from its start in likelihood is told, however wide its interval is.
        """
        left = False
        while self._free.any():
            wide = self._std() / [one.untold for one in self._sought]
            order = [place for place in np.argsort(-wide) if wide[place] > 1]
            doubtful = [place for place in order if self._free[place] and self._may_be_start(place)]
            if not doubtful:
                break
            self._free[doubtful[0]], self._at[doubtful[0]], left = False, 0.0, True
            self._fit()
        if left:
            self._settle()

    def _may_be_start(self, place: int) -> bool:
        """Whether the start is likely too, with the others where the curvature puts them."""
        assert self._here is not None, "there was a pass"
        free = np.flatnonzero(self._free)
        own, others = free == place, free != place
        curvature = self._here.information + np.diag(self._prior())
        at, change = self._at.copy(), -self._at[place]
        at[place] = 0.0
        if others.any():
            cross = curvature[np.ix_(others, own)][:, 0]
            at[free[others]] -= np.linalg.solve(curvature[np.ix_(others, others)], cross) * change
        values = self._values(at, self._moved)
        there = likelihood(self._log, values, 1, self._on_steps, slopes=False).value
        return there - self._here.value < _LIKELY

    def _found(self) -> tuple[FoundValue, ...]:
        """All values with their intervals."""
        found, step_s = [], self._log.setup.time_step_s
        quantile = float(t.ppf(0.975, BLOCKS - 1))
        std = self._std() if self._here is not None else np.full(len(self._at), np.inf)
        for place, one in enumerate(self._sought):
            at, wide = self._at[place], quantile * std[place]
            if not self._free[place] or not np.isfinite(wide):
                found.append(FoundValue(one.name, one.start, one.start, one.low, one.high, False))
                continue
            low, value, high = (float(one.value(x)) for x in (at - wide, at, at + wide))
            low = 0.0 if one.is_noise and std[place] > one.untold else low
            found.append(FoundValue(one.name, one.start, value, low, high, True))
        for name, steps in self._moved.items():
            start = self._start.get(name, 0.0)
            ends = self._within.get(name, (-self._farthest, self._farthest))
            low, high = (
                start + (end + half) * step_s for end, half in zip(ends, (-0.5, 0.5), strict=True)
            )
            told = ends[1] - ends[0] < self._farthest
            value = start + (steps if told else 0) * step_s
            found.append(FoundValue(name, start, value, low, high, told))
        return tuple(found)
