"""How good estimators are over many runs: figures with 95 % intervals, differences run by run."""

import msgspec
import numpy as np

from concord.filters.metrics import nees
from concord.papers.meng2025.runs import MeasuredBatch, SlotEstimates
from concord.results.figures.intervals import (
    Interval,
    chi_square_quantile,
    mean_t,
    positive_mean_t,
)

ELLIPSE = 0.95
DIVERGED = 1e3


class EstimatorRow(msgspec.Struct, frozen=True):
    """One estimator over steps 1..S of all runs that did not diverge.

    Attributes:
        rmse: of each state.
        anees: average of e' P^-1 e, which is n for a consistent estimator.
        coverage: share of the errors inside the 95 % ellipse.
        anees, coverage and mse_to_trace are None for one whose covariance is no claim of its own.
        diverged: share of the runs with an error above 1000, or none.
        mse: of the whole state, averaged over steps.
        mse_to_trace: the mean square error in units of what the filter reports, tr P.
        largest_error: of any state at any step.
        difference: mse minus that of the first row, run by run; None for the first.
    """

    name: str
    label: str
    rmse: list[Interval]
    anees: Interval | None
    coverage: Interval | None
    diverged: float
    mse: Interval
    mse_to_trace: float | None
    largest_error: float
    difference: Interval | None


def row(
    name: str,
    label: str,
    batch: MeasuredBatch,
    outcome: SlotEstimates,
    reference: SlotEstimates | None,
) -> EstimatorRow:
    """The figures of one outcome."""
    errors = outcome.mean[1:] - batch.truth[1:]
    lost = _diverged(errors)
    kept = errors[:, ~lost]
    cov = outcome.cov[1:, ~lost]
    squared = (kept**2).mean(axis=0)
    normalised = nees(kept, cov)
    inside = normalised <= chi_square_quantile(ELLIPSE, errors.shape[-1])
    trace = np.trace(cov, axis1=-2, axis2=-1).mean()
    return EstimatorRow(
        name,
        label,
        rmse=[_root(positive_mean_t(of_state)) for of_state in squared.T],
        anees=positive_mean_t(normalised.mean(axis=0)),
        coverage=mean_t(inside.mean(axis=0)),
        diverged=float(lost.mean()),
        mse=positive_mean_t(squared.sum(axis=-1)),
        mse_to_trace=float(squared.sum(axis=-1).mean() / trace),
        largest_error=float(np.abs(kept).max(initial=0.0)),
        difference=None if reference is None else difference(batch, outcome, reference),
    )


def mse_by_step(batch: MeasuredBatch, outcome: SlotEstimates) -> np.ndarray:
    """Mean square error (S + 1,) over runs, of the whole state."""
    return ((outcome.mean - batch.truth) ** 2).sum(axis=-1).mean(axis=1)


def running_mse(batch: MeasuredBatch, outcome: SlotEstimates, run: int = 0) -> np.ndarray:
    """Mean square error (S,) of one run over the steps 1..s, the printed formula with i = s.

    It forgets nothing: the error of the first steps stays in it, and its curve falls by itself.
    """
    squared = ((outcome.mean[1:, run] - batch.truth[1:, run]) ** 2).sum(axis=-1)
    return np.cumsum(squared) / np.arange(1, len(squared) + 1)


def trace_by_step(outcome: SlotEstimates) -> np.ndarray:
    """tr P (S + 1,), averaged over runs."""
    return np.trace(outcome.cov, axis1=-2, axis2=-1).mean(axis=1)


def difference(batch: MeasuredBatch, outcome: SlotEstimates, reference: SlotEstimates) -> Interval:
    """Mean square error minus that of the reference, run by run."""
    errors, known = (one.mean[1:] - batch.truth[1:] for one in (outcome, reference))
    kept = ~(_diverged(errors) | _diverged(known))
    ours, theirs = ((e[:, kept] ** 2).sum(axis=-1).mean(axis=0) for e in (errors, known))
    return mean_t(ours - theirs)


def _diverged(errors: np.ndarray) -> np.ndarray:
    """Which runs (R,) of errors (S, R, n) went astray."""
    return np.logical_not((np.abs(errors) <= DIVERGED).all(axis=(0, 2)))


def _root(square: Interval) -> Interval:
    return Interval(*(float(np.sqrt(max(x, 0.0))) for x in square))
