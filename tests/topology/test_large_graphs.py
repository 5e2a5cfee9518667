"""Ten thousand nodes: built, weighed and analysed without a dense matrix, and rightly."""

import math
import tracemalloc

import numpy as np
import pytest

from concord.topology.adjacency import neighbours_of
from concord.topology.analysis import require_connected
from concord.topology.graphs import build_graph, complete, regular, ring
from concord.topology.spectrum import (
    contraction_per_round,
    laplacian_bounds,
    second_eigenvalue_modulus,
)
from concord.topology.weights import (
    best_constant,
    build_weights,
    check_doubly_stochastic,
    check_weights,
    equal_neighbour,
    fastest_mixing,
    from_per_node,
    metropolis,
    per_node,
)

pytestmark = pytest.mark.slow

NODES = 10_000
# A dense matrix of one byte per entry has 100 MB.
MOST_MEMORY = 60e6


@pytest.mark.parametrize("name", ["ring", "geometric", "small-world", "scale-free"])
def test_a_large_sparse_graph_is_built_and_weighed_without_a_dense_matrix(name):
    tracemalloc.start()
    adjacency = build_graph(name, NODES, seed=1)
    require_connected(adjacency)
    weights = metropolis(adjacency)
    check_weights(weights, adjacency)
    check_doubly_stochastic(weights)
    neighbours = neighbours_of(adjacency)
    lists = per_node(weights, neighbours)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < MOST_MEMORY
    assert len(lists) == NODES
    assert not abs(from_per_node(lists, neighbours) - weights).max()
    assert [len(own) - 1 for own in lists] == [len(heard) for heard in neighbours]


@pytest.mark.slow
def test_a_large_ring_has_the_eigenvalues_of_its_closed_form():
    """Circulant: (1 + 2 cos(2 pi k / n)) / 3 of Metropolis weights, 2 - 2 cos of the Laplacian."""
    angle = 2 * math.pi / NODES
    modulus = second_eigenvalue_modulus(metropolis(ring(NODES)))
    assert 1 - modulus == pytest.approx(2 * (1 - math.cos(angle)) / 3, rel=1e-6)
    smallest, largest = laplacian_bounds(ring(NODES))
    assert smallest == pytest.approx(2 - 2 * math.cos(angle), rel=1e-6)
    assert largest == pytest.approx(4, rel=1e-6)


@pytest.mark.parametrize("name", ["geometric", "small-world", "scale-free", "6-regular"])
@pytest.mark.parametrize("rule", ["metropolis", "equal-neighbour", "best-constant"])
def test_sparse_eigenvalues_are_the_dense_ones(name, rule, monkeypatch):
    adjacency = build_graph(name, 200, seed=3)
    weights = build_weights(rule, adjacency)
    dense = (
        second_eigenvalue_modulus(weights),
        contraction_per_round(weights),
        laplacian_bounds(adjacency),
    )
    monkeypatch.setattr("concord.topology.spectrum.DENSE_NODES", 100)
    assert second_eigenvalue_modulus(weights) == pytest.approx(dense[0], rel=1e-7)
    assert contraction_per_round(weights) == pytest.approx(dense[1], rel=1e-7)
    assert laplacian_bounds(adjacency) == pytest.approx(dense[2], rel=1e-5)


def test_random_regular_graphs_are_expanders():
    """Alon and Boppana bound the second eigenvalue of a 6-regular graph by 2 sqrt(5) from below in
    the limit, and random ones come close to it (Friedman 2008)."""
    modulus = second_eigenvalue_modulus(equal_neighbour(regular(NODES, 6, seed=2)))
    bound = (1 + 2 * math.sqrt(5)) / 7
    assert bound * 0.99 < modulus < bound * 1.03


def test_what_grows_with_the_square_is_refused_with_its_numbers():
    with pytest.raises(ValueError, match=r"complete graph of 10000 nodes: it has 49995000 links"):
        complete(NODES)
    with pytest.raises(ValueError, match=r"fastest-mixing for 10000 nodes.*best-constant"):
        fastest_mixing(ring(NODES))


def test_weights_of_one_value_exist_for_large_graphs():
    weights = best_constant(build_graph("small-world", 2000, seed=1))
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
