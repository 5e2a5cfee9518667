"""The network of the consensus study: concord's rules and driver, on a bus that holds any share.

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
from concord.nodes.lanes.batch import AveragesInBatch, InBatch
from concord.nodes.lanes.network import BatchedNetwork
from concord.nodes.rules.fresh_consensus import FreshConsensus, FreshOwn, LastUsed
from concord.nodes.rules.information_rounds import InformationRounds
from concord.nodes.rules.lane_rule import Failures, LaneContent, Place
from concord.runtime.batched.build import build_network
from concord.runtime.batched.driver import run
from concord.scenarios.bus_plan import build_schedule
from concord.scenarios.preparation import share_bytes
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup


class Dropping(InformationRounds):
    """Rounds in which the weight of a silent neighbour falls to the node itself."""

    def fuse(
        self,
        cycle: int,
        weights: np.ndarray,
        prior: Gaussian,
        known: np.ndarray,
        belief: Gaussian,
        shares: np.ndarray,
    ) -> tuple[np.ndarray, Gaussian]:
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
    network = build_network(changed, runs, _with_room)
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


def _with_room(setup: Setup) -> TimelessBus:
    return TimelessBus(build_schedule(setup.scenario, setup.neighbours), share_bytes(setup))
