"""Errors of runs: of the nodes, of each node alone, and of one filter that hears everything."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import symmetrise
from concord.filters.metrics import consensus
from concord.results.records.extras import RunExtra, run_extras
from concord.scenarios.catalogue import beside_truth, definition_of, scored_nees
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.scenario_definition import Score
from concord.scenarios.setup import Setup


class RunTruths(NamedTuple):
    """Truth (R, S, n) and readings (R, S, N, r, d) of R runs of S steps, by which they are scored.

    `extras` has one value of each run of a scenario with `RunExtras`.
    """

    truth: np.ndarray
    readings: np.ndarray
    extras: Sequence[RunExtra] = ()


class NetworkErrors(NamedTuple):
    """Errors in the m scored states of R runs of N nodes in S steps; m = 1 of `RunExtras`.

    Attributes:
        nodes: (R, S, N, m).
        centre: (R, S, m), of one filter that hears everything.
        spread: (R, S, N, m), from the average of the nodes that believe something. NaN of
            `RunExtras`, which have no average.
        nees, nees_centre: (R, S, N) and (R, S), per state. NaN where estimates are sets, and in
            steps for which the model does not hold: there it cannot tell its errors.
    """

    nodes: np.ndarray
    centre: np.ndarray
    spread: np.ndarray
    nees: np.ndarray
    nees_centre: np.ndarray

    def of_run(self, first: int) -> "NetworkErrors":
        """Those of the first run from a step on, without the axis of the runs."""
        return NetworkErrors(*(part[0, first:] for part in self))

    def where(self, counted: np.ndarray) -> "NetworkErrors":
        """The same, NaN in steps that do not count."""
        return NetworkErrors(*(where_counted(counted, part) for part in self))


def network_errors(
    setup: Setup, known: RunTruths, mean: np.ndarray, nees: np.ndarray, centre: Gaussian
) -> NetworkErrors:
    """Of estimates mean (R, S, N, n) with nees (R, S, N), and centre (R, S, n)."""
    score = definition_of(setup.scenario).score
    of_centre = beside_truth(setup.scenario, centre.mean, known.truth) - known.truth
    means = mean[..., list(score.states)]
    spread = means - consensus(means)
    if is_set_valued(setup.scenario):
        nees, nees_centre = np.full_like(nees, np.nan), np.full(nees.shape[:2], np.nan)
    else:
        nees_centre = scored_nees(setup.scenario, of_centre, symmetrise(centre.cov))
    states, held = len(score.nees_states), np.logical_not(outside_steps(setup, centre.mean))
    consistency = (where_counted(held, one / states) for one in (nees, nees_centre))
    extras = run_extras(setup.scenario)
    if extras is not None:
        runs = list(zip(known.extras, known.readings, strict=True))
        nodes = np.stack([one.distances() for one, _ in runs])[..., None]
        hears_all = np.stack([extras.distances_of_centre(setup, *one) for one in runs])[..., None]
        return NetworkErrors(nodes, hears_all, np.full_like(nodes, np.nan), *consistency)
    of_nodes = (mean - known.truth[:, :, None])[..., list(score.states)]
    return NetworkErrors(of_nodes, of_centre[..., list(score.states)], spread, *consistency)


def outside_reasons(setup: Setup, mean: np.ndarray) -> dict[str, np.ndarray] | None:
    """Where estimates (R, S, n) are outside the model, by the reason; None for one that always
    holds."""
    outside = definition_of(setup.scenario).outside
    return None if outside is None else outside(setup.scenario, mean)


def outside_steps(setup: Setup, mean: np.ndarray) -> np.ndarray:
    """The steps (R, S) in which estimates (R, S, n) are outside the model for any reason."""
    reasons = outside_reasons(setup, mean) or {}
    return np.logical_or.reduce([np.zeros(mean.shape[:2], dtype=bool), *reasons.values()])


def errors_alone(setup: Setup, known: RunTruths, mean: np.ndarray) -> np.ndarray:
    """Errors (R, S, N, m) of nodes without neighbours, whose estimates are mean (R, S, N, n)."""
    extras = run_extras(setup.scenario)
    if extras is not None:
        runs = zip(known.extras, known.readings, strict=True)
        return np.stack([extras.distances_alone(setup, *one) for one in runs])[..., None]
    states = list(definition_of(setup.scenario).score.states)
    truth = known.truth[:, :, None]
    return (beside_truth(setup.scenario, mean, truth) - truth)[..., states]


def scored_steps(score: Score, readings: np.ndarray) -> np.ndarray:
    """Which steps (R, S) count: from the scenario's on, but not before the first reading."""
    steps = readings.shape[1]
    seen = np.logical_not(np.isnan(readings).all(axis=(-1, -2, -3)))
    # The first True; 0 where there is none.
    first_seen = seen.argmax(axis=1)
    first = np.minimum(np.maximum(score.first_step, first_seen), steps - 1)
    return np.arange(steps) >= first[:, None]


def where_counted(counted: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (R, S, ...), NaN in steps that do not count (R, S)."""
    return np.where(counted.reshape(*counted.shape, *(1,) * (values.ndim - 2)), values, np.nan)
