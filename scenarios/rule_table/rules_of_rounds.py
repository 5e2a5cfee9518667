"""Rules that use fresh shares alone: hcmci, icf, diffusion, kcf, centralised."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from concord.filters.fusion import (
    diffusion,
    hybrid_consensus,
    information_weighted,
    kalman_consensus,
)
from concord.filters.gaussian import Gaussian
from concord.nodes.rules.fresh_consensus import Exchange, FreshConsensus
from concord.nodes.rules.information_rounds import InformationRounds
from concord.nodes.rules.novelty_rounds import NoveltyRounds
from concord.scenarios.node_context import RuleContext
from concord.scenarios.rule_table.rule import (
    HYBRID,
    INFORMATION_PAIRS,
    NOVELTIES,
    NOVELTIES_AND_MEANS,
    AnyRule,
    averages_in_batch,
    once,
)
from concord.scenarios.scenario import Scenario, lossy_links
from concord.scenarios.types.schedules import FullSchedule

if TYPE_CHECKING:
    from concord.topology.weights import Weights


def _fresh(rule: Exchange, context: RuleContext) -> FreshConsensus:
    of_plant = context.origin, context.angles
    return FreshConsensus(rule, context.trigger, context.contends, *of_plant)


def hybrid(context: RuleContext) -> AnyRule:
    """For consensus on prior and novelty."""
    rows = np.eye(len(context.neighbours))

    def begin(node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        return hybrid_consensus.begin(prior, posterior, rows[node])

    rule = InformationRounds(
        begin,
        partial(hybrid_consensus.from_information, states=context.states),
        partial(hybrid_consensus.sound, states=context.states),
        pairs=2,
    )
    return _fresh(rule, context)


def weighted_information(context: RuleContext) -> AnyRule:
    """For information-weighted consensus."""
    nodes = len(context.neighbours)
    rule = InformationRounds(
        lambda _, prior, posterior: information_weighted.begin(prior, posterior, nodes),
        partial(information_weighted.from_information, nodes=nodes),
        information_weighted.sound,
    )
    return _fresh(rule, context)


def diffused(context: RuleContext) -> AnyRule:
    """For diffusion; on a complete graph with one round it is the centralised filter."""
    begin = kalman_consensus.begin if context.angles else diffusion.begin
    return _fresh(NoveltyRounds(begin, diffusion.incremental, diffusion.combine), context)


def pulled(context: RuleContext) -> AnyRule:
    """For the Kalman-consensus filter."""
    rate = kalman_consensus.largest_rate(max(len(heard) for heard in context.neighbours))
    rule = NoveltyRounds(
        kalman_consensus.begin,
        partial(kalman_consensus.correct, rate=rate),
        lambda means, _: kalman_consensus.average(means, rate),
    )
    return _fresh(rule, context)


def _require_the_average(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    # Only here: a check of a scenario may be slow to start, a node of the network may not.
    from concord.topology.weights import check_doubly_stochastic

    try:
        check_doubly_stochastic(weights)
    except ValueError as error:
        raise ValueError(
            f"rule {scenario.rule.name} multiplies the network's average by the number of nodes, "
            f"and needs weights that lead there: {error}; or choose rule hcmci, which takes any"
        ) from None


def _require_all_at_once(
    scenario: Scenario, neighbours: Sequence[Sequence[int]], weights: "Weights"
) -> None:
    everybody = len(neighbours) - 1
    deaf = [node for node, heard in enumerate(neighbours) if len(heard) < everybody]
    if deaf:
        raise ValueError(
            f"rule centralised on graph {scenario.network.graph}: node {deaf[0]} hears "
            f"{len(neighbours[deaf[0]])} of {everybody} others, and must hear all; use --graph "
            "complete, or rule hcmci, which comes near the centralised filter on any graph"
        )
    schedule = scenario.bus.schedule
    if not isinstance(schedule, FullSchedule):
        raise ValueError(
            f"rule centralised with --schedule {schedule.name}: every node must publish in "
            "every cycle; use --schedule full, or rule hcmci or ci, which do with less"
        )
    if lossy := lossy_links(scenario):
        raise ValueError(
            f"rule centralised with {lossy}: every node must hear all others in "
            "every step; leave that out, or use rule hcmci or ci, which do with less"
        )
    if scenario.rounds != 1:
        raise ValueError(
            f"rule centralised with --rounds {scenario.rounds}: one round tells everybody all, "
            "and a second would tell it twice; use --rounds 1"
        )


HCMCI = once(HYBRID, hybrid, partial(averages_in_batch, hybrid, HYBRID))
ICF = once(
    INFORMATION_PAIRS,
    weighted_information,
    partial(averages_in_batch, weighted_information, INFORMATION_PAIRS),
    check=_require_the_average,
    consistent=False,
)
DIFFUSION = once(NOVELTIES, diffused, consistent=False)
KCF = once(NOVELTIES_AND_MEANS, pulled, weighted=False, consistent=False)
CENTRALISED = once(NOVELTIES, diffused, check=_require_all_at_once, weighted=False)
