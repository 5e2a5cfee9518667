"""Errors, references and traffic of runs, each computed once, from which figures are made."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import mean_of_known
from concord.results.figures.network_errors import (
    NetworkErrors,
    RunTruths,
    errors_alone,
    network_errors,
    scored_steps,
    where_counted,
)
from concord.results.figures.run_frame import RunFrame
from concord.results.figures.smoothed_errors import SmoothedErrors, smoothed_errors
from concord.results.figures.traffic import traffic_of
from concord.results.records.extras import run_extras
from concord.results.records.runs import Runs
from concord.scenarios.baselines import local_only_of_runs
from concord.scenarios.catalogue import beside_truth, definition_of, scored_nees
from concord.scenarios.rule_table.rules import is_set_valued

# Covariances of so many filters beside are in memory at once.
_LANES_AT_ONCE = 1_024


class RunView:
    """R runs that have kept their readings and ages, and the filter that hears everything."""

    def __init__(self, runs: Runs, frame: RunFrame) -> None:
        assert runs.readings is not None and runs.ages is not None, "keep both"
        self.runs, self.frame, self.readings = runs, frame, runs.readings
        self.setup, self.score = runs.setup, definition_of(runs.setup.scenario).score
        self.counted = scored_steps(self.score, self.readings)
        """(R, S): the steps that count."""
        self._first = min(self.score.first_step, self.counted.shape[1] - 1)

    def scored(self, values: np.ndarray) -> np.ndarray:
        """Return values (R, S, ...) of the steps from the first scored one on, NaN in those that do
        not count."""
        values, counted = values[:, self._first :], self.counted[:, self._first :]
        return values if counted.all() else where_counted(counted, values)

    def root(self, squares: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
        """Return the root of the mean over axes of squares (R, S, ...) in the steps that count."""
        return np.sqrt(mean_of_known(self.scored(squares), axes))

    def mean(self, values: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
        """Return the mean over axes of values (R, S, ...) in the steps that count."""
        return mean_of_known(self.scored(values), axes)

    @cached_property
    def errors(self) -> NetworkErrors:
        """Errors of the nodes and of the filter that hears everything."""
        runs, centre = self.runs, Gaussian(self.frame.mean, self.frame.cov)
        return network_errors(self.setup, self._known, runs.mean, runs.nees, centre)

    @property
    def _known(self) -> RunTruths:
        return RunTruths(self.runs.truth, self.readings, self.runs.extras)

    @cached_property
    def squares(self) -> np.ndarray:
        """Squared errors (R, S, N) of the nodes in the scored states."""
        return (self.errors.nodes**2).sum(-1)

    @cached_property
    def squares_centralised(self) -> np.ndarray:
        """The same (R, S) of the filter that hears everything."""
        return (self.errors.centre**2).sum(-1)

    @cached_property
    def squares_alone(self) -> np.ndarray:
        """The same (R, S, N) of nodes without neighbours."""
        nodes = self.setup.scenario.nodes
        size = max(1, _LANES_AT_ONCE // nodes)
        runs = [
            self.runs.of(slice(first, first + size))
            for first in range(0, len(self.runs.runs), size)
        ]
        return np.concatenate([_squares_alone(part) for part in runs])

    @cached_property
    def spreads(self) -> np.ndarray:
        """Squared distances (R, S, N) from the average of the nodes."""
        return (self.errors.spread**2).sum(-1)

    @cached_property
    def squares_from_centralised(self) -> np.ndarray:
        """Squared distances (R, S, N) from the filter that hears everything; NaN for scenarios
        whose estimates are no states."""
        runs = self.runs
        if runs.extras:
            return np.full(self.blind.shape, np.nan)
        centre = self.frame.mean[:, :, None]
        apart = beside_truth(self.setup.scenario, runs.mean, centre) - centre
        return (apart[..., list(self.score.states)] ** 2).sum(-1)

    @cached_property
    def near(self) -> np.ndarray:
        """The steps (R, S) that are at most `near_s` after a reading by any node."""
        if self.score.near_s is None:
            return np.zeros(self.counted.shape, dtype=bool)
        seen = np.logical_not(np.asarray(np.isnan(self.readings).all(axis=(2, 3, 4))))
        reach = np.ones(round(self.score.near_s / self.setup.time_step_s) + 1)
        return np.array([np.convolve(row, reach)[: len(row)] > 0.5 for row in seen])

    @cached_property
    def blind(self) -> np.ndarray:
        """Which nodes took no reading in a step (R, S, N)."""
        return np.asarray(np.isnan(self.readings).all(axis=(-1, -2)))

    @cached_property
    def traffic(self) -> dict[str, np.ndarray]:
        """Figures of shares and bus by name (R,)."""
        return traffic_of(self.runs)

    @cached_property
    def smoothed(self) -> SmoothedErrors | None:
        """Errors (R, L) of the states of 0, 1, ... steps ago; None for rules without."""
        runs, central = self.runs, Gaussian(self.frame.mean, self.frame.cov)
        if runs.past is None:
            return None
        known = runs.truth, runs.control, self.counted
        return smoothed_errors(self.setup, runs.past, central, *known)

    def smoothed_last(self, central: bool) -> np.ndarray:
        """Return the error (R,) of the oldest of these states, or of the smoother that hears
        everything; NaN for rules without."""
        if self.smoothed is None:
            return np.full(len(self.readings), np.nan)
        return self.smoothed[central][:, -1]

    @cached_property
    def of_extras(self) -> dict[str, np.ndarray]:
        """Figures (R,) that the scenario's feature computes."""
        extras = run_extras(self.setup.scenario)
        if extras is None:
            return {}
        return extras.figures_of_runs(self.setup, self.runs.extras, self.readings)

    def counts(self, name: str) -> np.ndarray:
        """Return totals (R, N) of the counters whose names begin so."""
        none = np.zeros((len(self.readings), self.setup.scenario.nodes))
        return sum((n for key, n in self.runs.counters.items() if key.startswith(name)), none)

    @cached_property
    def finite_steps(self) -> np.ndarray:
        """After how many steps (R,) the truth of a simulated run is not finite, to its end.

        All steps where it stays finite. A log knows its truth at some steps alone, and targets
        come and go.
        """
        steps = self.runs.steps
        whole = np.full(len(self.readings), steps)
        if definition_of(self.setup.scenario).all_steps is not None or self.runs.extras:
            return whole
        truth = self.runs.truth[..., list(self.score.states)]
        finite = np.asarray(np.isfinite(truth).all(axis=-1))
        last = steps - np.argmax(finite[:, ::-1], axis=1)
        return np.where(finite.any(axis=1), last, whole)

    @cached_property
    def failed(self) -> np.ndarray:
        """Which runs (R,) have no meaning: a filter or fusion failed, the truth is not finite, or
        no node had a reading in any step that counts."""
        names = ("predict-failed", "update-failed", "fuse-failed")
        failures = sum(self.counts(name).sum(axis=1) for name in names)
        lost = self.finite_steps < self.runs.steps
        unread = self.blind.all(axis=2) | ~self.counted
        return np.asarray((failures > 0) | lost | unread.all(axis=1))

    def variances(self, cov: np.ndarray, states: Sequence[int] | None = None) -> np.ndarray:
        """Return the variances (..., m) of covariances (..., n, n), in some states or all."""
        found = np.diagonal(cov, axis1=-2, axis2=-1)
        return found if states is None else found[..., list(states)]

    @cached_property
    def sets(self) -> tuple["SetsBesideTruth", "SetsBesideTruth"] | None:
        """Of the nodes and of one that hears everything; None where estimates are beliefs."""
        runs, setup = self.runs, self.setup
        if not is_set_valued(setup.scenario):
            return None
        told = np.logical_not(np.isnan(runs.truth).any(axis=-1))
        off = self.frame.mean - runs.truth
        return (
            SetsBesideTruth(runs.nees, told[..., None] & runs.present, _roots(runs.cov_trace)),
            SetsBesideTruth(
                scored_nees(setup.scenario, off, self.frame.cov), told,
                _roots(np.trace(self.frame.cov, axis1=-2, axis2=-1)),
            ),
        )  # fmt: skip


def _squares_alone(runs: Runs) -> np.ndarray:
    assert runs.readings is not None, "RunView has looked"
    told = runs.readings, runs.control, runs.prior_mean
    alone = local_only_of_runs(runs.setup, runs.runs.tolist(), *told)
    known = RunTruths(runs.truth, runs.readings, runs.extras)
    return (errors_alone(runs.setup, known, alone.mean) ** 2).sum(-1)


class SetsBesideTruth(NamedTuple):
    """Ellipsoids e' P^-1 e <= 1: these values (R, S, ...), whether there is a set and a truth, and
    the half-widths sqrt(tr P)."""

    values: np.ndarray
    known: np.ndarray
    half_widths: np.ndarray

    def number(self, axes: tuple[int, ...]) -> np.ndarray:
        """Return how many sets there are over axes."""
        return self.known.sum(axis=axes)

    def outside(self, axes: tuple[int, ...]) -> np.ndarray:
        """Return how many sets do not hold the truth; one that cannot be computed is no proof."""
        return (self.known & ~(self.values <= 1.0)).sum(axis=axes)

    def largest(self, axes: tuple[int, ...]) -> np.ndarray:
        """Return the largest value over axes; NaN where none is known."""
        known = self.known & ~np.isnan(self.values)
        found = np.where(known, self.values, -np.inf).max(axis=axes)
        return np.where(known.any(axis=axes), found, np.nan)

    def half_width(self, axes: tuple[int, ...]) -> np.ndarray:
        """Return the mean half-width over axes."""
        return mean_of_known(self.half_widths, axes)


def _roots(squares: np.ndarray) -> np.ndarray:
    return np.sqrt(np.where(squares >= 0, squares, np.nan))
