"""The randomness of a run: a stream for each purpose at each node, from one seed."""

import hashlib
from typing import Protocol

import numpy as np


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
