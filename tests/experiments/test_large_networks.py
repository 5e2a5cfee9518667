"""Networks of thousands of nodes: what a run of them needs grows with the links, not with pairs."""

import tracemalloc

from experiments.vectorised import simulate
from scenarios.scenario import Scenario
from scenarios.setup import prepare

SPARSE = Scenario(name="oscillator", nodes=2000, graph="6-regular", steps=5, cluster="none")


def test_a_sparse_network_needs_no_array_of_pairs():
    setup = prepare(SPARSE)
    tracemalloc.start()
    histories = simulate(setup, [0])
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert histories.mean.shape[:3] == (1, 5, 2000)
    # Half of what one array of a float per pair of nodes takes.
    assert peak_bytes < 2000 * 2000 * 8 / 2
