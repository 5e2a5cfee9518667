"""Networks of thousands of nodes: what a run of them needs grows with the links, not with pairs.
Thousands of runs: with what is kept of them, and nothing else."""

import tracemalloc
from collections.abc import Iterable

import numpy as np
import pytest

from concord.results.records.runs import Runs
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.studies.monte_carlo import simulate as batched
from concord.studies.monte_carlo.simulate import COV, simulate

pytestmark = pytest.mark.slow

SPARSE = scenario_of("oscillator", nodes=2000, graph="6-regular", steps=5, bus="ideal")


def test_a_sparse_network_needs_no_array_of_pairs():
    setup = prepare(SPARSE)
    tracemalloc.start()
    histories = simulate(setup, [0])
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert histories.mean.shape[:3] == (1, 5, 2000)
    # Half of what one array of a float per pair of nodes takes.
    assert peak_bytes < 2000 * 2000 * 8 / 2


def kept_and_most(runs: int, keep: Iterable[str] = ()) -> tuple[int, int]:
    """Bytes of the histories of so many runs, and the most that was taken to make them."""
    setup = prepare(scenario_of("oscillator", nodes=4, steps=30, bus="ideal"))
    tracemalloc.start()
    histories: Runs = simulate(setup, range(runs), keep=keep)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    arrays = [*histories, *histories.counters.values()]
    return sum(one.nbytes for one in arrays if isinstance(one, np.ndarray)), most


def test_runs_are_taken_in_chunks_and_what_is_kept_is_what_was_asked_for(monkeypatch):
    kept_and_most(1)  # loads modules and fills caches once
    monkeypatch.setattr(batched, "LANES", 4 * 100)
    (of_one, most_of_one), (of_many, most_of_many) = kept_and_most(100), kept_and_most(600)
    assert of_many == 6 * of_one
    # Six chunks at once would take six times as much beside what is kept.
    assert most_of_many - of_many < 2.5 * (most_of_one - of_one)
    with_covariances, _ = kept_and_most(100, keep=(COV,))
    # A covariance of n states in place of nothing: n n numbers of each node and step.
    assert with_covariances == of_one + 100 * 30 * 4 * 2 * 2 * 8
