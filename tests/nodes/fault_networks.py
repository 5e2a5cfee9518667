"""Rings of four nodes on which faults strike from a step on."""

from collections import Counter

from concord.results.records.trace import Trace
from concord.scenarios.setup import Setup
from tests.experiments.support import small

STEPS, FIRST = 12, 3
ROUNDS = 3


def ring(**changes) -> Setup:
    return small(**{"nodes": 4, "graph": "ring", "steps": STEPS, **changes})


def total(trace: Trace) -> Counter[str]:
    """Counters of all nodes together."""
    return sum((Counter(one) for one in trace.counters), Counter())


def from_first(*lines: str) -> list[str]:
    return [f"{FIRST} {line}" for line in lines]
