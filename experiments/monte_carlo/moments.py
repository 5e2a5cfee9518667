"""Moments of the figures of many runs, which merge to the same bits in any order and grouping.

A piece of a Monte Carlo is reduced to them where it is computed, so that results do not grow with
the number of runs. Sums are exact (`exact_sums`). Quantiles come from counts of runs in fixed bins,
64 to an octave: a quantile is within 0.8 % of that of the runs.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from concord.experiments.monte_carlo.exact_sums import (
    SCALE,
    ExactSums,
    added,
    exact_sums,
    quotient,
)
from concord.experiments.monte_carlo.figure_table import FIGURES

QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
# `spread` is the standard deviation of the squares over their mean: an interval of a root mean
# square needs it.
STATISTICS = ("count", "mean", "std", "rms", "spread", "least", "greatest",
              *(f"q{100 * part:02.0f}" for part in QUANTILES))  # fmt: skip
# FigureArrays and what each is compared with in the same run.
PAIRS = {
    "rmse_to_centralised": ("rmse", "rmse_centralised"),
    "worst_node_to_centralised": ("rmse_worst_node", "rmse_centralised"),
    "blind_to_centralised": ("rmse_blind", "rmse_centralised"),
    "smoothed_to_centralised": ("rmse_smoothed", "rmse_smoothed_centralised"),
    "anees_to_centralised": ("anees", "anees_centralised"),
}
# `ratio` is that of the root mean squares, `spread` the standard deviation of its linearised
# logarithm; `difference` and `difference_std` are those of the figures themselves.
PAIR_STATISTICS = ("count", "ratio", "spread", "difference", "difference_std")
_PARTS = tuple(f"moments {part}" for part in ("sums", "lowest", "counts", "ends", "bins"))
_SUMS, _LOWEST, _COUNTS, _ENDS, _BINS = _PARTS
# Bits of a number below its exponent and the six highest bits of its mantissa.
_BELOW_BIN = 46
_BINS_OF_A_FIGURE = 2**18
_POWERS, _PAIR_SUMS = 3, 7
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
    values = np.where(finite, every, 0.0)
    squares = values**2
    sums = [values, squares, squares**2]
    counts = [known.sum(axis=0), (known & ~finite).sum(axis=0)]
    pairs, both_known = _of_pairs(columns, figures)
    found = exact_sums(np.concatenate([*sums, pairs], axis=1))
    # A figure that is unknown in all runs has no least value.
    ends = [np.where(known, every, np.inf).min(axis=0), np.where(known, every, -np.inf).max(axis=0)]
    return {
        **{name: values for name, values in figures.items() if name not in names},
        _SUMS: found.parts,
        _LOWEST: np.array(found.lowest),
        _COUNTS: np.concatenate([*counts, both_known]),
        _ENDS: np.array(ends),
        _BINS: _binned([figures[name] for name in columns.counted]),
    }


def merged(one: FigureArrays, other: FigureArrays) -> dict[str, np.ndarray]:
    """Return the moments of the runs of both."""
    sums = added(_exact(one), _exact(other))
    ends = np.array([one[_ENDS], other[_ENDS]])
    bins, counts = np.concatenate([one[_BINS], other[_BINS]], axis=1)
    where, inverse = np.unique(bins, return_inverse=True)
    return {
        _SUMS: sums.parts,
        _LOWEST: np.array(sums.lowest),
        _COUNTS: one[_COUNTS] + other[_COUNTS],
        _ENDS: np.array([ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)]),
        _BINS: np.array([where, np.bincount(inverse, counts, len(where)).astype(np.int64)]),
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
    totals = _exact(figures).integers
    powers = totals[: _POWERS * width].reshape(_POWERS, width)
    known, infinite = figures[_COUNTS][: 2 * width].reshape(2, width)
    table = np.full((len(STATISTICS), width), np.nan)
    for column in range(width):
        table[:5, column] = _statistics(int(known[column]), powers[:, column])
    # The mean of values of which one is infinite is infinite too; its spread is unknown.
    table[1:5, infinite > 0] = np.array([np.inf, np.nan, np.inf, np.nan])[:, None]
    least, greatest = table[5:7] = np.where(known > 0, figures[_ENDS], np.nan)
    # Squares are rounded, so that deviations below 1e-8 of the mean are not seen; none is none.
    table[np.ix_((2, 4), (least == greatest) & (known > 1) & (infinite == 0))] = 0.0
    found, start = {}, 0
    for name, shape in shapes.items():
        end = start + int(np.prod(shape))
        found[name] = table[:, start:end].reshape(-1, *shape)
        start = end
    for number, name in enumerate(columns.counted):
        found[name][7:] = _quantiles(figures[_BINS], number, *found[name][5:7])
    of_pairs = zip(
        columns.paired,
        figures[_COUNTS][2 * width :].tolist(),
        totals[_POWERS * width :].reshape(-1, _PAIR_SUMS),
        strict=True,
    )
    return found | {name: _pair(count, sums) for name, count, sums in of_pairs}


def _columns(shapes: Mapping[str, tuple[int, ...]]) -> ReducedColumns:
    return ReducedColumns(
        {n: s[1:] if "run" in FIGURES[n].dimensions else s for n, s in shapes.items()}
    )


def _by_run(name: str, values: np.ndarray, runs: int) -> np.ndarray:
    """Return a figure as one of each run: a bound stands for every run of its piece."""
    return values if "run" in FIGURES[name].dimensions else np.array([values] * runs)


def _of_pairs(columns: ReducedColumns, figures: FigureArrays) -> tuple[np.ndarray, np.ndarray]:
    """Terms (R, 7 each) of the sums of each pair, and in how many runs both are known."""
    runs = len(figures["rmse"])
    terms, counts = [np.empty((runs, 0))], []
    for name, other in columns.paired.values():
        one, two = figures[name], figures[other]
        both = (np.abs(one) < LARGEST) & (np.abs(two) < LARGEST)
        one, two = np.where(both, one, 0.0), np.where(both, two, 0.0)
        s, o = one**2, two**2
        terms.append(np.stack([s, o, s * s, o * o, s * o, one - two, (one - two) ** 2], axis=1))
        counts.append(np.count_nonzero(both))
    return np.concatenate(terms, axis=1), np.array(counts, dtype=np.int64)


def _exact(figures: FigureArrays) -> ExactSums:
    return ExactSums(int(figures[_LOWEST]), figures[_SUMS])


def _statistics(count: int, powers: np.ndarray) -> tuple[float, ...]:
    """Count, mean, standard deviation, root mean square, spread of the squares."""
    if count == 0:
        return (0.0, *(np.nan,) * 4)
    one, two, four = powers.tolist()
    deviation = np.sqrt(_variance(count, one, two))
    square = quotient(two, count * SCALE)
    spread = quotient(count * count * _scatter(count, two, four), count * (count - 1) * two * two)
    rms = np.sqrt(square)
    # All squares 0: the root mean square has no spread.
    spread = 0.0 if two == 0 and count > 1 else np.sqrt(max(spread, 0.0))
    return float(count), quotient(one, count * SCALE), float(deviation), float(rms), float(spread)


def _scatter(count: int, total: int, squares: int) -> int:
    """Count times the sum of squares less the square of the sum, in units of SCALE squared."""
    return max(count * squares * SCALE - total * total, 0)


def _variance(count: int, total: int, squares: int) -> float:
    return quotient(_scatter(count, total, squares), count * (count - 1) * SCALE * SCALE)


def _pair(count: int, sums: np.ndarray) -> np.ndarray:
    """Return the `PAIR_STATISTICS`; sums of squares, their squares and product, differences."""
    if count == 0:
        return np.array([0.0, *(np.nan,) * 4])
    p, q, pp, qq, pq, difference, squares = sums.tolist()
    # Half of s / mean(s) - o / mean(o) has the mean 0 and this sum of squares, times p p q q.
    influence = max(SCALE * (pp * q * q + qq * p * p - 2 * pq * p * q), 0) * count * count
    spread = np.sqrt(quotient(influence, 4 * (count - 1) * p * p * q * q)) if p else 0.0
    deviation = np.sqrt(_variance(count, difference, squares))
    ratio = np.sqrt(quotient(p, q))
    return np.array([count, ratio, spread, quotient(difference, count * SCALE), deviation])


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
