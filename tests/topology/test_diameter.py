"""The diameter, or bounds of it: against all distances of small graphs, and textbook shapes."""

import networkx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array

from concord.topology.analysis import components, diameter_bounds
from concord.topology.graphs import build_graph, grid, path, ring, star


@given(st.integers(1, 14), st.integers(0, 2**32 - 1), st.booleans(), st.integers(1, 20))
def test_the_diameter_is_that_of_all_distances_and_bounds_hold_it(
    nodes: int, seed: int, directed: bool, searches: int
):
    links = np.random.default_rng(seed).random((nodes, nodes)) < 0.3
    links |= np.roll(np.eye(nodes, dtype=bool), 1, axis=1)  # in one piece
    np.fill_diagonal(links, False)
    links = links if directed else links | links.T
    adjacency = csr_array(links)
    assert len(components(adjacency)) == 1
    expected = networkx.diameter(networkx.DiGraph(links)) if nodes > 1 else 0
    assert diameter_bounds(adjacency) == (expected, expected)
    least, most = diameter_bounds(adjacency, searches)
    assert least <= expected <= most


@pytest.mark.parametrize(
    ("adjacency", "expected"),
    [
        (grid(50, 60), 108),
        (path(4000), 3999),
        (star(3000), 2),
        (build_graph("geometric", 3000, 1), None),
    ],
    ids=["grid", "path", "star", "geometric"],
)
def test_few_searches_tell_the_diameter_of_most_shapes(adjacency: csr_array, expected: int | None):
    least, most = diameter_bounds(adjacency, searches=700)
    assert least == most
    assert expected is None or least == expected


def test_where_all_are_as_far_from_their_farthest_bounds_are_said():
    """Of a ring every search says the same of its node, and next to nothing of the others."""
    least, most = diameter_bounds(ring(2000), searches=64)
    assert least == 1000 < most < 2 * least
    assert diameter_bounds(ring(2000)) == (1000, 1000)
