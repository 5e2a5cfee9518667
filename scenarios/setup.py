"""A scenario worked out: the graph, the weights and the prior as plain data.

A `Setup` is all that a process of the network is told. It is data and not objects, so that any
process anywhere builds the same node from it, and so that its digest tells whether two processes
agree.
"""

import msgspec

from concord.scenarios.scenario import Scenario


class Setup(msgspec.Struct, frozen=True):
    """Everything about a run but its randomness, which follows from the seed.

    Attributes:
        scenario: what was asked for, with nothing left open.
        neighbours: whom each node hears, ascending.
        weights: per node, its own weight first, then its neighbours'.
        initial_state, prior_mean (n,), prior_cov (n, n): where truth and filters begin.
        time_step_s: sampling time of the plant.
        losses: per node, the chance that a frame of each neighbour is lost, where links have their
            own; phases: whom each node hears in each of the graphs that take turns.
    """

    scenario: Scenario
    neighbours: list[list[int]]
    weights: list[list[float]]
    initial_state: list[float | None]
    prior_mean: list[float]
    prior_cov: list[list[float]]
    time_step_s: float
    losses: list[list[float]] | None = None
    phases: list[list[list[int]]] | None = None
