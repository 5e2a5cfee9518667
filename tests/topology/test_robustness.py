"""Robustness of graphs against its definition, and on graphs of which it is known."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.topology.analysis import EXACT_NODES, is_robust


def complete(nodes: int) -> list[list[int]]:
    return [[j for j in range(nodes) if j != i] for i in range(nodes)]


def ring(nodes: int) -> list[list[int]]:
    return [sorted({(i - 1) % nodes, (i + 1) % nodes}) for i in range(nodes)]


def by_definition(neighbours: list[list[int]], reach: int) -> bool:
    """All pairs of sets without a common node, as sets."""
    everyone = range(len(neighbours))
    sets = [set(s) for size in range(1, len(neighbours)) for s in combinations(everyone, size)]

    def reachable(some: set[int]) -> bool:
        return any(len(set(neighbours[i]) - some) >= reach for i in some)

    return all(
        reachable(one) or reachable(other) for one in sets for other in sets if not one & other
    )


@st.composite
def graphs(draw: st.DrawFn) -> list[list[int]]:
    nodes = draw(st.integers(2, 6))
    return [
        sorted(draw(st.sets(st.sampled_from([j for j in range(nodes) if j != i]))))
        for i in range(nodes)
    ]


@given(graphs(), st.integers(1, 3))
def test_it_is_the_definition(neighbours: list[list[int]], reach: int):
    assert is_robust(neighbours, reach) == by_definition(neighbours, reach)


@pytest.mark.parametrize("nodes", [3, 4, 7, 8, 11])
def test_a_complete_graph_is_robust_to_half_of_its_nodes_and_no_more(nodes: int):
    half = (nodes + 1) // 2
    assert is_robust(complete(nodes), half)
    assert not is_robust(complete(nodes), half + 1)


@pytest.mark.parametrize("nodes", [5, 8, 12])
def test_a_ring_is_connected_and_holds_no_liar(nodes: int):
    assert is_robust(ring(nodes), 1)
    assert not is_robust(ring(nodes), 3)
    # Two halves hear one node of the other each at either end.
    assert not is_robust(ring(nodes), 2)


def test_two_crowds_with_few_links_between_them_are_not_robust_however_dense():
    """Each node hears at least four others, yet neither half convinces a node of the other."""
    crowd = complete(5)
    both = [*crowd, *([j + 5 for j in heard] for heard in crowd)]
    for i in range(5):
        both[i].append(i + 5)
        both[i + 5].insert(0, i)
    assert min(map(len, both)) == 5
    assert is_robust(both, 1)
    assert not is_robust(both, 2)


def test_of_large_graphs_the_degree_tells_or_nobody_does():
    nodes = EXACT_NODES + 10
    assert is_robust(complete(nodes), 3)
    assert is_robust(ring(nodes), 3) is False
    wide = [sorted((i + step) % nodes for step in (-3, -2, -1, 1, 2, 3)) for i in range(nodes)]
    assert is_robust(wide, 3) is None
