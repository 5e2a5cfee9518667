"""A fusion rule as the table of rules has it."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.earlier_belief import EarlierBelief
from concord.nodes.estimator import AnyEstimator
from concord.nodes.rules.local_filter import Model
from concord.scenarios.node_context import BatchContext, NodeContext
from concord.scenarios.rule_table.share_kinds import BELIEFS, ShareKind
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    from concord.nodes.lanes.network import BatchedRule
    from concord.topology.weights import Weights


class Rule(NamedTuple):
    """A fusion rule of the network.

    Attributes:
        share: what its shares are; None where `share_bytes` tells their length.
        estimator: builds that of one node.
        batched: builds the rule at all nodes of many runs.
        check: refuses scenario, neighbours of each node and weights (N, N) that it cannot do with.
        set_at_step: (set of an earlier step, step, model) -> the set of that step. Given for a rule
            whose covariances are shape matrices of ellipsoids that hold the truth for certain.
        baseline_filter: (setup, nodes, readings (steps, N, r, d), control (steps, p) or None) ->
            beliefs (steps,) of one filter that takes the readings of these nodes; None for the
            Gaussian filter of the scenario.
        lacking: what of a scenario the batched rule does not have; None if it has all.
        consistent: it claims that covariances cover the errors, or that sets hold the truth.
        weighted: the network's consensus weights are used.
        share_bytes: (scenario, states) -> length of the longest share of a rule without `share`.
    """

    share: ShareKind | None
    estimator: Callable[[NodeContext], AnyEstimator]
    batched: Callable[[BatchContext], "BatchedRule"]
    check: "Callable[[Scenario, Sequence[Sequence[int]], Weights], None] | None" = None
    set_at_step: Callable[[EarlierBelief, int, Model], Gaussian] | None = None
    baseline_filter: (
        Callable[[Setup, Sequence[int], np.ndarray, np.ndarray | None], Gaussian] | None
    ) = None
    lacking: Callable[[Scenario], str | None] = lambda _: None
    weighted: bool = True
    consistent: bool = True
    share_bytes: Callable[[Scenario, int], int] | None = None

    @property
    def set_valued(self) -> bool:
        """Whether beliefs are sets that hold the truth for certain."""
        return self.set_at_step is not None

    @property
    def shares_beliefs(self) -> bool:
        """Whether a share is a mean and a covariance."""
        return self.share is BELIEFS
