"""The random streams of many runs at once; each is that of `concord.scenarios.setup.generator`.

To seed a stream takes four times as long as to draw two hundred numbers from it. The node, the last
word of a stream's key, is therefore mixed in for all nodes of all runs at once, by the arithmetic
of `numpy.random.SeedSequence`, of which numpy promises that it stays.

Source: O'Neill (2015), Developing a seed_seq alternative.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.random import PCG64, Generator, SeedSequence
from numpy.random.bit_generator import ISeedSequence

from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import code_of

# Words of 32 bits: in a seed sequence, and in what a generator begins with.
_POOL, _STATE = 4, 8
_FIRST_IN, _FACTOR_IN = 0x43B0D7E5, 0x931E8875
_FIRST_OUT, _FACTOR_OUT = 0x8B51F9DD, 0x58F38DED
_LEFT, _RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_HALF = np.uint32(16)

StreamOf = Callable[[int, str, int], Generator]
"""(which of the runs, purpose, node) -> the stream, from its beginning."""


def streams_of(scenario: Scenario, runs: Sequence[int]) -> StreamOf:
    """The streams of a scenario in the runs of these numbers."""
    nodes = np.arange(scenario.nodes, dtype=np.uint32)

    @cache
    def states(purpose: str, first: int) -> np.ndarray:
        return beginnings(scenario.seed, runs, code_of(purpose), first + nodes)

    def stream(which: int, purpose: str, node: int) -> Generator:
        place = node % len(nodes)
        worked = _Worked(states(purpose, node - place)[which, place])
        return Generator(PCG64(worked))  # type: ignore[arg-type]

    return stream


def beginnings(seed: int, runs: Sequence[int], code: int, nodes: np.ndarray) -> np.ndarray:
    """Return the initial state of PCG64 after `SeedSequence(seed, spawn_key=(run, code, node))`.

    The result is (R, N, 4) of uint64, for nodes (N,) of uint32.
    """
    # All words but the last, as numpy mixes them, and the constant that it has come to.
    before = np.stack([SeedSequence(seed, spawn_key=(run, code)).pool for run in runs])
    counts = [max(_POOL, _words(seed)) + _words(run) + _words(code) for run in runs]
    reached = [_FIRST_IN * pow(_FACTOR_IN, _POOL * count, 1 << 32) % (1 << 32) for count in counts]
    constant = np.array(reached, dtype=np.uint32)[:, None]
    pool = []
    for word in range(_POOL):
        hashed, constant = _hashed(nodes, constant, _FACTOR_IN)
        mixed = _LEFT * before[:, word, None] - _RIGHT * hashed
        pool.append(mixed ^ (mixed >> _HALF))
    states = np.empty((len(runs), len(nodes), _STATE), dtype=np.uint64)
    constant = np.full((1, 1), _FIRST_OUT, dtype=np.uint32)
    for word in range(_STATE):
        states[..., word], constant = _hashed(pool[word % _POOL], constant, _FACTOR_OUT)
    return states[..., ::2] | states[..., 1::2] << np.uint64(32)


def _hashed(value: np.ndarray, constant: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """A hash of words, and the constant for the next."""
    following = constant * np.uint32(factor)
    hashed = (value ^ constant) * following
    return hashed ^ (hashed >> _HALF), following


def _words(number: int) -> int:
    return max(1, -(-number.bit_length() // 32))


class _Worked(ISeedSequence):
    """A seed sequence that is already worked out; numpy's types do not say that it takes one."""

    def __init__(self, state: np.ndarray) -> None:
        self._state = state

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> np.ndarray:
        """Return the words that PCG64 asks for: four of 64 bits."""
        return self._state
