"""Moments of the figures of many runs: pieces that are merged in one order give the same bits.

A piece of a Monte Carlo is reduced to them where it is computed, so that results do not grow with
the number of runs. Means and sums of squared deviations are merged as by Chan, Golub and LeVeque
(1983), Algorithms for computing the sample variance. Quantiles come from counts of runs in fixed
bins, 64 to an octave: a quantile is within 0.8 % of that of the runs.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from concord.results.figures.figure_table import FIGURES, RATIOS, SWEPT

QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
# `spread` is the standard deviation of the squares over their mean: an interval of a root mean
# square needs it.
STATISTICS = ("count", "mean", "std", "rms", "spread", "least", "greatest",
              *(f"q{100 * part:02.0f}" for part in QUANTILES))  # fmt: skip
# Figures and what each is compared with in the same run.
PAIRS = {
    name: (ratio.one, ratio.other)
    for name, ratio in RATIOS.items()
    if {ratio.one, ratio.other} <= set(SWEPT)
}
# `ratio` is that of the root mean squares, `spread` the standard deviation of its linearised
# logarithm; `difference` and `difference_std` are those of the figures themselves.
PAIR_STATISTICS = ("count", "ratio", "spread", "difference", "difference_std")
_PARTS = tuple(
    f"moments {part}" for part in ("counts", "means", "deviations", "infinite", "ends", "bins")
)
_COUNTS, _MEANS, _DEVIATIONS, _INFINITE, _ENDS, _BINS = _PARTS
# Bits of a number below its exponent and the six highest bits of its mantissa.
_BELOW_BIN = 46
_BINS_OF_A_FIGURE = 2**18
_OF_A_PAIR = 4
# Fourth powers of larger numbers are infinite, so these numbers count as infinite too.
LARGEST = 2.0**240

FigureArrays = Mapping[str, np.ndarray]


class ReducedColumns(NamedTuple):
    """The figures that are reduced, and the shape of each without the axis of the runs."""

    shapes: dict[str, tuple[int, ...]]

    @property
    def paired(self) -> dict[str, tuple[str, str]]:
        """Return the pairs of which both figures are reduced."""
        return {name: pair for name, pair in PAIRS.items() if self.shapes.keys() >= set(pair)}

    @property
    def counted(self) -> list[str]:
        """Return the figures that have quantiles: one number a run."""
        return [name for name in self.shapes if FIGURES[name].dimensions == ("run",)]


def reduced(figures: FigureArrays, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the figures of R runs, those of these names as moments that `merged` takes."""
    columns = _columns({name: figures[name].shape for name in names})
    runs = len(figures["rmse"])
    every = np.concatenate(
        [_by_run(name, figures[name], runs).reshape(runs, -1) for name in names], axis=1
    )
    known = ~np.isnan(every)
    finite = np.abs(every) < LARGEST
    values = np.where(finite, every, np.nan)
    features = np.concatenate([values, values**2, *_of_pairs(columns, figures)], axis=1)
    counts = (~np.isnan(features)).sum(axis=0)
    means = np.nansum(features, axis=0) / np.maximum(counts, 1)
    # A figure that is unknown in all runs has no least value.
    ends = [np.where(known, every, np.inf).min(axis=0), np.where(known, every, -np.inf).max(axis=0)]
    return {
        **{name: values for name, values in figures.items() if name not in names},
        _COUNTS: counts,
        _MEANS: means,
        _DEVIATIONS: np.nansum((features - means) ** 2, axis=0),
        _INFINITE: (known & ~finite).sum(axis=0),
        _ENDS: np.array(ends),
        _BINS: _binned([figures[name] for name in columns.counted]),
    }


def merged(one: FigureArrays, other: FigureArrays) -> dict[str, np.ndarray]:
    """Return the moments of the runs of both."""
    counts = one[_COUNTS] + other[_COUNTS]
    part, step = other[_COUNTS] / np.maximum(counts, 1), other[_MEANS] - one[_MEANS]
    between = step**2 * (one[_COUNTS] * part)
    ends = np.array([one[_ENDS], other[_ENDS]])
    bins, runs = np.concatenate([one[_BINS], other[_BINS]], axis=1)
    where, inverse = np.unique(bins, return_inverse=True)
    return {
        _COUNTS: counts,
        _MEANS: one[_MEANS] + step * part,
        _DEVIATIONS: one[_DEVIATIONS] + other[_DEVIATIONS] + between,
        _INFINITE: one[_INFINITE] + other[_INFINITE],
        _ENDS: np.array([ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)]),
        _BINS: np.array([where, np.bincount(inverse, runs, len(where)).astype(np.int64)]),
    }


def apart(figures: FigureArrays) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the moments, and the figures that are not reduced."""
    moments = {name: values for name, values in figures.items() if name in _PARTS}
    return moments, {name: values for name, values in figures.items() if name not in _PARTS}


def statistics_of(
    figures: FigureArrays, shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, np.ndarray]:
    """Return the `STATISTICS` (statistics, ...) of the reduced figures, `PAIR_STATISTICS` of
    `PAIRS`, and the bounds, by name.

    Args:
        figures: moments.
        shapes: of the figures that were reduced, without their runs, in the same order.
    """
    columns = ReducedColumns(dict(shapes))
    width = sum(int(np.prod(shape)) for shape in shapes.values())
    moments = np.array([figures[part] for part in _PARTS[:3]])
    (count, _), (mean, square), off = moments[:, : 2 * width].reshape(3, 2, width)
    infinite = figures[_INFINITE]
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.sqrt(off / (count - 1))
        of_runs = [mean, std[0], np.sqrt(square), std[1] / square]
    table = np.full((len(STATISTICS), width), np.nan)
    table[0] = count + infinite
    table[1:5] = np.where(count > 0, of_runs, np.nan)
    # The mean of values of which one is infinite is infinite too; its spread is unknown.
    table[1:5, infinite > 0] = np.array([np.inf, np.nan, np.inf, np.nan])[:, None]
    least, greatest = table[5:7] = np.where(table[0] > 0, figures[_ENDS], np.nan)
    # Rounding gives equal values a spread.
    table[np.ix_((2, 4), (least == greatest) & (count > 1) & (infinite == 0))] = 0.0
    found, start = {}, 0
    for name, shape in shapes.items():
        end = start + int(np.prod(shape))
        found[name] = table[:, start:end].reshape(-1, *shape)
        start = end
    for number, name in enumerate(columns.counted):
        found[name][7:] = _quantiles(figures[_BINS], number, *found[name][5:7])
    pairs = moments[:, 2 * width :].reshape(3, _OF_A_PAIR, -1)
    return found | {name: _pair(*pairs[..., number]) for number, name in enumerate(columns.paired)}


def _columns(shapes: Mapping[str, tuple[int, ...]]) -> ReducedColumns:
    return ReducedColumns(
        {n: s[1:] if "run" in FIGURES[n].dimensions else s for n, s in shapes.items()}
    )


def _by_run(name: str, values: np.ndarray, runs: int) -> np.ndarray:
    """Return a figure as one of each run: a bound stands for every run of its piece."""
    return values if "run" in FIGURES[name].dimensions else np.array([values] * runs)


def _of_pairs(columns: ReducedColumns, figures: FigureArrays) -> np.ndarray:
    """Features (4, R, P) of each pair: both squares, their sum, the difference of the figures."""
    found = np.full((_OF_A_PAIR, len(figures["rmse"]), len(columns.paired)), np.nan)
    for place, (name, other) in enumerate(columns.paired.values()):
        one, two = figures[name], figures[other]
        both = (np.abs(one) < LARGEST) & (np.abs(two) < LARGEST)
        one, two = one[both], two[both]
        found[:, both, place] = one**2, two**2, one**2 + two**2, one - two
    return found


def _pair(counts: np.ndarray, means: np.ndarray, deviations: np.ndarray) -> np.ndarray:
    """Return the `PAIR_STATISTICS` from the moments (4,) of the features of a pair."""
    count, (p, q, _, difference) = counts[0], means
    if count == 0:
        return np.array([0.0, *(np.nan,) * 4])
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two, both, off = deviations / (count - 1)
        # The variance of half of s / mean(s) - o / mean(o).
        influence = (one / p**2 + two / q**2 - (both - one - two) / (p * q)) / 4
        spread = np.sqrt(np.maximum(influence, 0.0)) if p else 0.0
        return np.array([count, np.sqrt(p / q), spread, difference, np.sqrt(off)])


def _binned(figures: Sequence[np.ndarray]) -> np.ndarray:
    """Return bins (2, B): their numbers, which hold those of the figures, and counts of runs."""
    numbers = [
        number * _BINS_OF_A_FIGURE + _bins_of(values[~np.isnan(values)])
        for number, values in enumerate(figures)
    ]
    if not numbers:
        return np.empty((2, 0), dtype=np.int64)
    return np.array(np.unique(np.concatenate(numbers), return_counts=True))


def _bins_of(values: np.ndarray) -> np.ndarray:
    # Bits of numbers of 0 or more are in the order of the numbers. No figure is negative.
    return np.abs(values).view(np.int64) >> _BELOW_BIN


def _quantiles(
    bins: np.ndarray, number: int, least: np.ndarray, greatest: np.ndarray
) -> np.ndarray:
    """Return the quantiles of a figure: the middle of the bin that holds the run of that rank."""
    mine = bins[0] // _BINS_OF_A_FIGURE == number
    where, counts = bins[0][mine] % _BINS_OF_A_FIGURE, bins[1][mine]
    if not len(where):
        return np.full(len(QUANTILES), np.nan)
    reached = np.cumsum(counts)
    ranks = np.ceil(np.array(QUANTILES) * reached[-1])
    chosen = where[np.searchsorted(reached, ranks)]
    # The bin of infinity has no upper edge.
    upper = np.minimum(chosen + 1, _bins_of(np.array([np.inf])))
    edges = np.array([chosen, upper]) << _BELOW_BIN
    return np.clip(edges.view(float).mean(axis=0), least, greatest)
