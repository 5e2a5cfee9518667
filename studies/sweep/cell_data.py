"""The figures of one cell of a result with their intervals, whether it has runs or moments."""

from typing import TYPE_CHECKING

import numpy as np

from concord.results.figures.figure_table import FIGURES
from concord.results.figures.intervals import METHODS, Interval, on_log_scale
from concord.studies.monte_carlo.convergence import settling_interval, settling_steps
from concord.studies.monte_carlo.moments import PAIRS

if TYPE_CHECKING:
    import xarray

_NAMES = {pair: name for name, pair in PAIRS.items()}


class CellData:
    """A cell's part of a result; `method` is one of `intervals.METHODS`.

    Moments have Student's interval only, and no interval of a settling time.
    """

    def __init__(self, part: "xarray.Dataset", method: str = "t") -> None:
        self._part = part
        self._mean, self._ratio = METHODS[method]

    def has_runs(self, name: str) -> bool:
        """Return whether a figure is there run by run."""
        return "run" in self._part[name].dims

    def interval(self, name: str) -> Interval:
        """Return a figure over the runs, by its statistic in the table of figures."""
        return self.root_mean(name) if FIGURES[name].statistic == "rms" else self.mean(name)

    def mean(self, name: str) -> Interval:
        """Return the mean over runs of a figure of 0 or more."""
        if self.has_runs(name):
            return self._mean(self.values(name))
        count, mean, std = (self._statistic(name, one) for one in ("count", "mean", "std"))
        if not mean > 0:
            return Interval(float(mean), float(mean + 0 * std), float(mean + 0 * std))
        return on_log_scale(float(mean), int(count), float(std / mean))

    def root_mean(self, name: str, unit: float = 1.0) -> Interval:
        """Return the root mean square over runs of a figure, as a multiple of a known number."""
        if self.has_runs(name):
            squares = np.square(self.values(name))
            return self._ratio(squares, np.full_like(squares, unit**2))
        count, rms, spread = (self._statistic(name, one) for one in ("count", "rms", "spread"))
        return on_log_scale(float(rms / unit), int(count), float(spread / 2))

    def ratio(self, name: str, other: str) -> Interval:
        """Return the ratio of the root mean squares of two figures of the same runs."""
        if self.has_runs(name):
            return self._ratio(np.square(self.values(name)), np.square(self.values(other)))
        pair = self._part[_NAMES[name, other]].sel
        count, ratio, spread = (
            float(pair(pair_statistic=one)) for one in ("count", "ratio", "spread")
        )
        return on_log_scale(ratio, int(count), spread)

    def to(self, best: "CellData", name: str) -> Interval:
        """Return the ratio of a figure to that of another cell, in the same runs.

        Moments are over the runs of each cell alone, so that the interval is not known.
        """
        if self.has_runs(name):
            return self._ratio(np.square(self.values(name)), np.square(best.values(name)))
        if self is best:
            return Interval(1.0, 1.0, 1.0)
        ratio = self._statistic(name, "rms") / best._statistic(name, "rms")
        return Interval(float(ratio), np.nan, np.nan)

    def rms(self, name: str) -> np.ndarray:
        """Return the root mean square of a figure over the runs, NaN ones left out: (...)."""
        if not self.has_runs(name):
            return self._statistic(name, "rms")
        squares = np.square(self.values(name))
        known = ~np.isnan(squares)
        total, count = np.where(known, squares, 0.0).sum(axis=0), known.sum(axis=0)
        return np.sqrt(np.divide(total, count, np.full(total.shape, np.nan), where=count > 0))

    def spread(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return how many runs know a figure, and the standard deviation of its squares over their
        mean: (...), (...)."""
        if not self.has_runs(name):
            return self._statistic(name, "count"), self._statistic(name, "spread")
        squares = np.square(self.values(name))
        count = np.full(squares.shape[1:], float(len(squares)))
        if len(squares) < 2:
            return count, np.full_like(count, np.nan)
        return count, squares.std(axis=0, ddof=1) / squares.mean(axis=0)

    def settling(self, change_step: int) -> Interval:
        """Return the steps from the change until the error stays settled."""
        if not self.has_runs("error"):
            error = self.rms("error")
            steps = settling_steps(error[None, ~np.isnan(error)], change_step)
            return Interval(steps, np.nan, np.nan)
        error = self.values("error")
        return settling_interval(error[:, ~np.isnan(error).all(axis=0)], change_step)

    def values(self, name: str) -> np.ndarray:
        """Return a variable as it is in the file."""
        return self._part[name].to_numpy()

    def _statistic(self, name: str, statistic: str) -> np.ndarray:
        return self._part[name].sel(statistic=statistic).to_numpy()
