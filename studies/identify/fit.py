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
_USUAL_PASSES = 6  # of a fit from its start
_USUAL_LAST_PASSES = 4  # of a fit from where the first steps have put it
_SPREAD = 3.0  # of the prior of noise, in logarithms
_UNTOLD = 0.7  # standard deviation of the logarithm of noise from which nothing is told
_ENOUGH = 1e-3  # squared length of a step in standard deviations at the end
_REACH = (-8, -4, -2, -1, 1, 2, 4, 8)  # steps by which a delay is tried
_FARTHEST = 64  # steps that a delay may move in all
_LIKELY = 1.92  # half of the 95 % quantile of chi-square with one degree of freedom


def usual_steps(steps: int) -> int:
    """Steps of all passes that a fit to a log of so many steps usually takes."""
    if steps > 2 * COARSE_STEPS:
        return _USUAL_PASSES * COARSE_STEPS + _USUAL_LAST_PASSES * steps
    return _USUAL_PASSES * steps


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
    def spread(self) -> float:
        """Standard deviation of the prior: for a parameter, all that its bounds leave."""
        whole = float(np.log(self.high / self.low)) if self.low > 0 else 1.0
        return _SPREAD if self.is_noise else whole

    @property
    def untold(self) -> float:
        """Standard deviation from which the log tells nothing: 95 % are all that bounds leave."""
        return _UNTOLD if self.is_noise else self.spread / 3.92

    def value(self, at: np.ndarray | float) -> np.ndarray:
        """The values (...) at coordinates (...)."""
        moved = at * (self.high - self.low) + self.start
        return np.clip(self.start * np.exp(at) if self.low > 0 else moved, self.low, self.high)


class FoundValue(NamedTuple):
    """A value after the fit, with its interval of 95 %. It stays at `before` where the log has not
    `told` it; a noise that is too small to be seen has the low end 0."""

    name: str
    before: float
    value: float
    low: float
    high: float
    told: bool


class ValueFit:
    """The fit of some values and delays to a log, from a start by name."""

    def __init__(
        self,
        log: HeardReadings,
        sought: Sequence[SoughtValue],
        delays: Sequence[str],
        start: Mapping[str, float],
        on_steps: Callable[[int], None],
    ) -> None:
        self._sought, self._start, self._on_steps = sought, dict(start), on_steps
        self._step_s, self._farthest = log.setup.time_step_s, min(_FARTHEST, log.steps // 10)
        if delays:
            ends = max(abs(round(start.get(name, 0.0) / self._step_s)) for name in delays)
            kinds = {name.partition(".")[2] for name in delays}
            log = log.without_ends(kinds, self._farthest + ends)
        self._whole = self._log = log
        self._at, self._free = np.zeros(len(sought)), np.ones(len(sought), dtype=bool)
        self._moved = dict.fromkeys(delays, 0)
        self._within = dict.fromkeys(delays, (-self._farthest, self._farthest))
        self._here: InnovationLikelihood | None = None

    def run(self) -> bool:
        """Fit, and return whether it came to its end; an interrupt leaves the best so far."""
        try:
            if self._whole.steps > 2 * COARSE_STEPS:
                self._log = self._whole.cut(COARSE_STEPS)
                self._settle()
                self._log = self._whole
            self._settle()
            self._leave_untold()
        except KeyboardInterrupt:
            return False
        return True

    def found(self) -> tuple[FoundValue, ...]:
        """All values with their intervals."""
        found, quantile = [], float(t.ppf(0.975, BLOCKS - 1))
        std = self._std() if self._here is not None else np.full(len(self._at), np.inf)
        for one, at, wide, free in zip(self._sought, self._at, std, self._free, strict=True):
            if not free or not np.isfinite(wide):
                found.append(FoundValue(one.name, one.start, one.start, one.low, one.high, False))
                continue
            reach = quantile * wide
            low, value, high = (float(one.value(x)) for x in (at - reach, at, at + reach))
            if wide > one.untold:  # its start was refused by the likelihood itself
                low, high = (low, min(high, one.start)) if at < 0 else (max(low, one.start), high)
                low = 0.0 if one.is_noise and at < 0 else low
            found.append(FoundValue(one.name, one.start, value, low, high, True))
        for name, (first, last) in self._within.items():
            start = self._start.get(name, 0.0)
            told = last - first < self._farthest and not first <= 0 <= last
            low, high = (start + self._step_s * step for step in (first - 0.5, last + 0.5))
            value = start + self._step_s * self._moved[name] * told
            found.append(FoundValue(name, start, value, low, high, told))
        return tuple(found)

    def _settle(self) -> None:
        """Fit values and delays in turn, until no delay moves."""
        self._fit()
        for _ in range(4):
            if not any([self._move(name) for name in self._moved]):
                return
            self._fit()

    def _likelihood(
        self, at: np.ndarray, moved: Mapping[str, Any] = {}, slopes: bool = False
    ) -> InnovationLikelihood:
        """The likelihood at coordinates (p,) or (lanes, p), and delays of so many steps."""
        values: dict[str, Any] = dict(self._start)
        for place, one in enumerate(self._sought):
            values[one.name] = one.value(at[..., place])
        for name, steps in {**self._moved, **moved}.items():
            values[name] = self._start.get(name, 0.0) + steps * self._step_s
        lanes = max([1, *(np.size(one) for one in values.values())])
        return likelihood(self._log, values, lanes, self._on_steps, slopes)

    def _curvature(self, here: InnovationLikelihood) -> tuple[np.ndarray, np.ndarray]:
        """Precision of the prior (p,) of the free coordinates, and curvature (p, p) with it."""
        prior = 1 / np.square([one.spread for one in self._sought])[self._free]
        return prior, here.information + np.diag(prior)

    def _fit(self) -> None:
        """Fit the free coordinates with delays as they are."""
        free, passes = np.flatnonzero(self._free), {}

        def there(part: np.ndarray) -> InnovationLikelihood:
            key = part.tobytes()
            if key not in passes:
                lanes = np.tile(self._at, (1 + len(free), 1))
                lanes[:, free] = part
                lanes[1 + np.arange(len(free)), free] += DIFFERENCE
                passes[key] = self._likelihood(lanes, slopes=True)
            return passes[key]

        def cost(part: np.ndarray) -> tuple[float, np.ndarray]:
            found = there(part)
            prior, _ = self._curvature(found)
            value = found.value + 0.5 * float(prior @ part**2)
            return min(value, 1e300), np.nan_to_num(found.slopes + prior * part)

        def stop_near(part: np.ndarray) -> None:
            self._at[free], self._here = part, there(part)
            slopes = cost(part)[1]
            if slopes @ np.linalg.solve(self._curvature(self._here)[1], slopes) < _ENOUGH:
                raise StopIteration

        self._here = there(self._at[free])
        if len(free):
            minimize(
                cost, self._at[free], jac=True, hess=lambda part: self._curvature(there(part))[1],
                method="trust-exact", callback=stop_near,
                options={"maxiter": MOST_PASSES, "max_trust_radius": 4.0},
            )  # fmt: skip

    def _move(self, name: str) -> bool:
        """Move a delay to the likeliest number of steps; return whether it moved."""
        before, known = self._moved[name], {}
        while True:
            here = self._moved[name]
            tried = [here, *(here + by for by in _REACH if abs(here + by) <= self._farthest)]
            fresh = [steps for steps in tried if steps not in known]
            if fresh:
                values = self._likelihood(self._at, {name: np.array(fresh)}).lanes.tolist()
                known |= dict(zip(fresh, values, strict=True))
            self._moved[name] = min(tried, key=lambda steps: (known[steps], abs(steps)))
            if self._moved[name] == here:
                break
        likely = [steps for steps, value in known.items() if value - known[here] < _LIKELY]
        self._within[name] = min(likely), max(likely)
        return here != before

    def _std(self) -> np.ndarray:
        """Standard deviations (p,) of all coordinates, the larger of those by the information and
        by the scatter of the scores; 0 of fixed ones."""
        assert self._here is not None, "there was a pass"
        inverse, std = np.linalg.inv(self._curvature(self._here)[1]), np.zeros(len(self._sought))
        each = (inverse, inverse @ self._here.scatter @ inverse)
        std[self._free] = np.sqrt(np.maximum(*(np.diagonal(cov) for cov in each)))
        return std

    def _leave_untold(self) -> None:
        """Put what the log does not tell back to its start, the least known first, and fit again.

        A value that is far from its start in likelihood is told, however wide its interval is.
        """
        left = False
        while True:
            wide = self._std() / [one.untold for one in self._sought]
            order = [place for place in np.argsort(-wide) if wide[place] > 1]
            doubtful = next((place for place in order if self._may_be_start(place)), None)
            if doubtful is None:
                break
            kept = np.flatnonzero(self._free) != doubtful
            assert self._here is not None, "there was a pass"
            several = [
                values[kept][:, kept] for values in (self._here.information, self._here.scatter)
            ]
            self._here = self._here._replace(information=several[0], scatter=several[1])
            self._free[doubtful], self._at[doubtful], left = False, 0.0, True
            self._fit()
        if left:
            self._settle()

    def _may_be_start(self, place: int) -> bool:
        """Whether the start is likely too, with the others where the curvature puts them."""
        assert self._here is not None, "there was a pass"
        free = np.flatnonzero(self._free)
        others, curvature = free != place, self._curvature(self._here)[1]
        at = self._at.copy()
        cross = curvature[others][:, ~others][:, 0] * at[place]
        at[free[others]] += np.linalg.solve(curvature[others][:, others], cross)
        at[place] = 0.0
        return self._likelihood(at).value - self._here.value < _LIKELY
