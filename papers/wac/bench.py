"""A scenario of the consensus study with its runs, on which rules are tried and scored."""

from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees
from concord.papers.wac.network import beliefs_of, network_of
from concord.results.figures.intervals import positive_mean_t, ratio_t
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate


class PaperScenario(NamedTuple):
    """A scenario of section 4. Errors count from `first_step` on. `position_only`: of the position,
    relative to the centralised filter; else of all states, each in its standard deviation there."""

    name: str
    scenario: Scenario
    runs: int
    first_step: int
    position_only: bool


class VariantCell(NamedTuple):
    """One variant at one occupancy: RMSE with its interval, disagreement, ANEES of the network and
    of its worst node, and the low end of the latter's interval."""

    rmse: float
    low: float
    high: float
    disagreement: float
    anees: float
    anees_worst: float
    anees_worst_low: float


class Bench(NamedTuple):
    """A study, its network on a bus without limits, and what the network is measured against.

    truth: (steps, R, n); scale: (n,), what squared errors of the states are multiplied by;
    central_squared: (runs,), the mean squared error that 1 stands for; central_rmse, central_anees:
    of the centralised filter.
    """

    study: PaperScenario
    setup: Setup
    truth: np.ndarray
    scale: np.ndarray
    central_squared: np.ndarray
    central_rmse: float
    central_anees: float


def bench_of(study: PaperScenario) -> Bench:
    """Simulate a study, and run the centralised filter on it."""
    setup = prepare(study.scenario.with_(bus="ideal", rule="local"))
    runs = range(study.runs)
    histories = simulate(setup, runs)
    assert histories.readings is not None, "simulate keeps the readings"
    listened = centralised_of_runs(setup, runs, histories.readings, histories.control)
    central = Gaussian(listened.mean.swapaxes(0, 1), listened.cov.swapaxes(0, 1))
    truth = histories.truth.swapaxes(0, 1)
    errors = (central.mean - truth)[study.first_step :]
    scale = _scale(study, central)
    squared = (errors**2 * scale).sum(axis=-1).mean(axis=0)
    consistency = nees(errors, central.cov[study.first_step :]).mean() / errors.shape[-1]
    return Bench(
        study,
        setup,
        truth,
        scale,
        squared if study.position_only else np.ones(study.runs),
        float(np.sqrt(squared.mean())),
        float(consistency),
    )


def attempt(bench: Bench, scenario: Scenario, unheard: str = "") -> VariantCell:
    """The study's runs of a scenario that differs from the study's in rule, rounds and schedule.

    `unheard` is as in `network.network_of`.
    """
    network = network_of(bench.setup, scenario, range(bench.study.runs), unheard)
    return _score(bench, beliefs_of(network))


def _scale(study: PaperScenario, central: Gaussian) -> np.ndarray:
    n = central.mean.shape[-1]
    if study.position_only:
        scored = definition_of(study.scenario).score.states
        return np.isin(np.arange(n), scored).astype(np.float64)
    return 1 / (n * np.asarray(np.diagonal(central.cov[-1, 0])))


def _score(bench: Bench, belief: Gaussian) -> VariantCell:
    first = bench.study.first_step
    mean, cov = belief.mean[first:], belief.cov[first:]
    errors = mean - bench.truth[first:, :, None]
    spread = mean - mean.mean(axis=2, keepdims=True)
    squared = (errors**2 * bench.scale).sum(axis=-1).mean(axis=(0, 2))
    apart = (spread**2 * bench.scale).sum(axis=-1).mean(axis=(0, 2))
    consistency = nees(errors, cov).mean(axis=0) / errors.shape[-1]
    of_worst = consistency[:, consistency.mean(axis=0).argmax()]
    # 95 % for all nodes together: the worst was chosen among them.
    worst = positive_mean_t(of_worst, 1 - 0.05 / consistency.shape[1])
    return VariantCell(
        *ratio_t(squared, bench.central_squared),
        float(np.sqrt(apart.mean() / bench.central_squared.mean())),
        float(consistency.mean()),
        worst.value,
        worst.low,
    )
