"""The network of the consensus study, on a bus that holds any share, and the scores of its rules.

A scenario is refused where FlexRay's cycle cannot hold its shares; the study gives a slot to each.
It also lets HCMCI and ICF use shares that are missing or old, which concord refuses.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import msgspec
import numpy as np

from concord.bus.ideal import TimelessBus
from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees
from concord.nodes.lanes.batch import AveragesInBatch, InBatch
from concord.nodes.lanes.network import BatchedNetwork
from concord.nodes.rules.fresh_consensus import FreshConsensus, FreshOwn, LastUsed
from concord.nodes.rules.information_rounds import InformationRounds
from concord.nodes.rules.lane_rule import Failures, LaneContent, Place
from concord.results.figures.intervals import positive_mean_t, ratio_t
from concord.runtime.batched.build import build_network
from concord.runtime.batched.driver import run
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.bus_table.bus_plan import build_schedule
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare, share_bytes
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate


class Dropping(InformationRounds):
    """Rounds in which the weight of a silent neighbour falls to the node itself."""

    def fuse(
        self, cycle: int, weights: np.ndarray, prior: Gaussian, known: np.ndarray,
        belief: Gaussian, shares: np.ndarray,
    ) -> tuple[np.ndarray, Gaussian]:  # fmt: skip
        """Implement `fresh_consensus.Exchange.fuse`."""
        shares = np.where(np.isnan(shares), shares[..., :1, :], shares)
        return super().fuse(cycle, weights, prior, known, belief, shares)


class LastShares(NamedTuple):
    """Cycles since each neighbour's share was used (..., J), and its numbers (..., J, m)."""

    ages: np.ndarray
    numbers: np.ndarray


_HeldContent = LaneContent[FreshOwn, Any]
"""Its held values are `LastShares`."""


class HoldingConsensus(FreshConsensus):
    """A rule of fresh shares that takes a silent neighbour to repeat its last share."""

    def start(self, node: np.ndarray, prior: Gaussian, held: Gaussian) -> _HeldContent:
        """The prior, and neighbours never heard."""
        content = super().start(node, prior, held)
        ages = content.held.ages
        numbers = np.zeros((*ages.shape, content.own.known.shape[-1]))
        return content._replace(held=LastShares(ages, numbers))

    def fuse(
        self, place: Place, content: _HeldContent, shares: np.ndarray, heard: np.ndarray
    ) -> tuple[_HeldContent, Failures]:
        """One round of the rule with the last share of each neighbour."""
        ages, before = content.held
        numbers = np.where(heard[..., None], shares, before)
        fresh = content._replace(held=LastUsed(ages))
        after, failures = super().fuse(place, fresh, numbers, heard | (ages >= 0))
        return after._replace(held=LastShares(after.held.ages, numbers)), failures


def network_of(
    setup: Setup, scenario: Scenario, runs: Sequence[int], unheard: str
) -> BatchedNetwork:
    """The runs of these numbers, of a scenario on the network of a setup.

    Args:
        setup: of a scenario with the same plant and graph.
        scenario: its schedule may have slots for shares of any length.
        runs: their numbers.
        unheard: "drop" or "raw", for a rule of fresh shares; else concord's rule as it is.
    """
    changed = msgspec.structs.replace(setup, scenario=scenario)
    network = build_network(
        changed,
        runs,
        lambda one: TimelessBus(build_schedule(one.scenario, one.neighbours), share_bytes(one)),
    )
    (segment,) = network.segments
    rule = segment.settings.rule
    if not isinstance(rule, AveragesInBatch) or unheard not in ("drop", "raw"):
        return network
    fresh = rule.rule
    assert isinstance(fresh, FreshConsensus) and isinstance(fresh.exchange, InformationRounds)
    if unheard == "drop":
        used = replace(fresh, exchange=Dropping(*fresh.exchange))
    else:
        used = HoldingConsensus(fresh.exchange, fresh.trigger, fresh.contends)
    rule = InBatch(used, rule.filters, rule.links, rule.base, rule.codec)
    return replace(
        network, segments=(segment._replace(settings=segment.settings._replace(rule=rule)),)
    )


def beliefs_of(network: BatchedNetwork) -> Gaussian:
    """Beliefs of all nodes after each step: (steps, R, N, n), (steps, R, N, n, n)."""
    beliefs = [instant.belief for instant in run(network)]
    return Gaussian(np.stack([one.mean for one in beliefs]), np.stack([one.cov for one in beliefs]))


# --- scores --------------------------------------------------------------------------------------


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
    if study.position_only:
        score = definition_of(study.scenario).score
        scale = np.isin(np.arange(errors.shape[-1]), score.states).astype(np.float64)
    else:
        scale = 1 / (errors.shape[-1] * np.asarray(np.diagonal(central.cov[-1, 0])))
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

    `unheard` is as in `network_of`.
    """
    belief = beliefs_of(network_of(bench.setup, scenario, range(bench.study.runs), unheard))
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
