"""A scenario worked out: the graph, the weights and the prior as plain data.

A `Setup` is all that a process of the network is told. It is data and not objects, so that any
process anywhere builds the same node from it, and so that its digest tells whether two processes
agree.
"""

import hashlib
from collections.abc import Sequence
from typing import Protocol

import msgspec
import numpy as np

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

    @property
    def links(self) -> tuple[np.ndarray, np.ndarray]:
        """Receiver and sender (E,) of each link, in order of the receiver and then the sender."""
        degrees = [len(heard) for heard in self.neighbours]
        sender = np.array([j for heard in self.neighbours for j in heard], dtype=np.int64)
        return np.repeat(np.arange(len(degrees)), degrees), sender

    def __post_init__(self) -> None:
        """Check that all parts are of one network, because a setup is also read from files.

        Raises:
            ValueError: a neighbour that is no other node, or parts of different sizes.
        """
        nodes, states = self.scenario.nodes, len(self.prior_mean)
        for graph in (self.neighbours, *(self.phases or ())):
            _check_neighbours(graph, nodes)
        lengths = (len(self.weights), len(self.losses if self.losses is not None else self.weights))
        if lengths != (nodes, nodes):
            raise ValueError(f"weights or losses of {lengths} nodes, in a network of {nodes}")
        if [len(row) for row in self.prior_cov] != [states] * states:
            raise ValueError(f"prior_cov is no square matrix of the {states} states of prior_mean")


def _check_neighbours(graph: Sequence[Sequence[int]], nodes: int) -> None:
    if len(graph) != nodes:
        raise ValueError(f"neighbours of {len(graph)} nodes, in a network of {nodes}")
    for node, heard in enumerate(graph):
        strange = [j for j in heard if not 0 <= j < nodes or j == node]
        if strange or sorted(set(heard)) != list(heard):
            raise ValueError(
                f"neighbours of node {node}: {list(heard)[:9]}; each is another node from 0 to "
                f"{nodes - 1}, named once, in ascending order"
            )


class Seeded(Protocol):
    """A scenario, as far as its randomness goes."""

    @property
    def seed(self) -> int: ...
    @property
    def run(self) -> int: ...


def generator(scenario: Seeded, purpose: str, node: int) -> np.random.Generator:
    """The random stream of one purpose at one node in one run of a scenario."""
    return np.random.default_rng(stream_of(scenario, purpose, node))


def stream_of(scenario: Seeded, purpose: str, node: int) -> np.random.SeedSequence:
    """The randomness of one purpose at one node in one run of a scenario."""
    return np.random.SeedSequence(scenario.seed, spawn_key=(scenario.run, code_of(purpose), node))


def code_of(purpose: str) -> int:
    """A purpose as a number of 32 bits, which does not depend on what other purposes there are."""
    return int.from_bytes(hashlib.sha256(purpose.encode()).digest()[:4], "big")


def key_of(scenario: Seeded, purpose: str) -> tuple[int, int]:
    """Two words of 64 bits that belong to a purpose in one run of a scenario."""
    first, second = stream_of(scenario, purpose, 0).generate_state(2, np.uint64).tolist()
    return first, second
