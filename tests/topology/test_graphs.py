"""Graphs: the figures that textbooks give for each family, and what every graph must be."""

import math

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.entries import entries
from concord.topology import graphs
from concord.topology.geometric_graphs import geometric, scatter
from concord.topology.graphs import (
    build_graph,
    complete,
    erdos_renyi,
    grid,
    near_square,
    path,
    regular,
    ring,
    scale_free,
    small_world,
    star,
)
from concord.topology.names import graph_names

SIZES = st.integers(1, 30)
SEEDS = st.integers(0, 2**32 - 1)


def assert_graph(adjacency, nodes):
    assert adjacency.shape == (nodes, nodes)
    assert adjacency.dtype == bool
    assert adjacency.nnz == adjacency.toarray().sum()
    assert (adjacency != adjacency.T).nnz == 0
    assert not adjacency.diagonal().any()


def same(one, other):
    return one.shape == other.shape and (one != other).nnz == 0


def diameter(adjacency):
    """Longest distance; networkx refuses a graph in pieces."""
    return networkx.diameter(networkx.from_scipy_sparse_array(adjacency))


@given(nodes=SIZES)
@settings(deadline=None)
def test_fixed_shapes_have_their_textbook_degrees_and_diameters(nodes):
    for build, links, longest in (
        (path, nodes - 1, nodes - 1),
        (star, nodes - 1, min(nodes - 1, 2)),
        (complete, nodes * (nodes - 1) // 2, min(nodes - 1, 1)),
        (ring, nodes if nodes > 2 else nodes - 1, nodes // 2),
    ):
        adjacency = build(nodes)
        assert_graph(adjacency, nodes)
        assert adjacency.sum() == 2 * links
        assert diameter(adjacency) == longest
    assert star(nodes)[[0]].sum() == nodes - 1


@given(rows=st.integers(1, 6), columns=st.integers(1, 6))
@settings(deadline=None)
def test_a_grid_joins_exactly_the_cells_at_distance_one(rows, columns):
    adjacency = grid(rows, columns)
    assert_graph(adjacency, rows * columns)
    adjacency = adjacency.toarray()
    cell = np.array([(row, column) for row in range(rows) for column in range(columns)])
    steps = np.abs(cell[:, None] - cell).sum(axis=-1)
    assert (adjacency == (steps == 1)).all()


@pytest.mark.parametrize(
    ("nodes", "sides"), [(1, (1, 1)), (12, (3, 4)), (36, (6, 6)), (20, (4, 5))]
)
def test_a_grid_is_as_square_as_its_number_allows(nodes, sides):
    assert near_square(nodes) == sides


@pytest.mark.parametrize("nodes", [2, 3, 7, 13])
def test_a_prime_number_of_nodes_has_no_grid(nodes):
    with pytest.raises(ValueError, match="two factors above 1"):
        near_square(nodes)


@given(nodes=st.integers(3, 24), degree=st.integers(2, 6), seed=SEEDS)
@settings(deadline=None, max_examples=50)
def test_a_regular_graph_is_regular_and_connected_or_refused(nodes, degree, seed):
    if degree >= nodes or nodes * degree % 2:
        with pytest.raises(ValueError, match="product even"):
            regular(nodes, degree, seed)
        return
    adjacency = regular(nodes, degree, seed)
    assert_graph(adjacency, nodes)
    assert (adjacency.sum(axis=1) == degree).all()
    assert diameter(adjacency) < nodes


def test_one_link_each_connects_two_nodes_and_no_more():
    assert same(regular(2, 1, 0), complete(2))
    with pytest.raises(ValueError, match="cannot be connected"):
        regular(4, 1, 0)


@given(nodes=st.integers(1, 25), seed=SEEDS)
@settings(deadline=None, max_examples=40)
def test_a_geometric_graph_joins_exactly_the_pairs_in_range(nodes, seed):
    positions = np.random.default_rng(seed).uniform(size=(nodes, 2))
    adjacency = geometric(positions, 0.4)
    assert_graph(adjacency, nodes)
    for one in range(nodes):
        for other in range(nodes):
            near = math.dist(positions[one], positions[other]) <= 0.4
            assert adjacency[one, other] == (near and one != other)


def test_the_radio_range_itself_is_within_range():
    assert geometric(np.array([[0.0, 0.0], [3.0, 4.0]]), 5.0)[0, 1]
    assert not geometric(np.array([[0.0, 0.0], [3.0, 4.0]]), 4.999)[0, 1]


def test_scattered_positions_are_in_the_unit_square():
    positions = scatter(40, seed=3)
    assert positions.shape == (40, 2)
    assert (positions > 0).all() and (positions < 1).all()


RANDOM = ["erdos-renyi", "small-world", "scale-free", "4-regular", "3-regular", "geometric"]


@pytest.mark.parametrize("name", RANDOM)
@given(half=st.integers(3, 15), seed=SEEDS)
@settings(deadline=None, max_examples=20)
def test_a_random_graph_is_connected_and_determined_by_its_seed(name, half, seed):
    nodes = 2 * half
    adjacency = build_graph(name, nodes, seed)
    assert_graph(adjacency, nodes)
    assert diameter(adjacency) < nodes
    assert same(adjacency, build_graph(name, nodes, seed))


@pytest.mark.parametrize("name", RANDOM)
def test_another_seed_gives_another_graph(name):
    graphs = {build_graph(name, 20, seed).toarray().tobytes() for seed in range(5)}
    assert len(graphs) == 5


def test_random_families_have_the_number_of_links_of_their_definition():
    # Connectedness is almost sure at these densities, so conditioning on it does not show.
    count = np.array([erdos_renyi(30, 0.4, seed).sum() / 2 for seed in range(200)])
    pairs = 30 * 29 / 2
    assert abs(count.mean() - 0.4 * pairs) < 5 * math.sqrt(pairs * 0.4 * 0.6 / 200)
    assert small_world(30, 4, 0.3, seed=1).sum() / 2 == 60
    assert scale_free(30, 2, seed=1).sum() / 2 == (30 - 2) * 2
    lattice = small_world(12, 4, 0.0, seed=1)
    around = np.abs(np.arange(12)[:, None] - np.arange(12))
    assert (lattice.toarray() == np.isin(np.minimum(around, 12 - around), (1, 2))).all()


def test_every_graph_that_can_be_built_is_among_the_names():
    of_a_shape = {"K-regular", "geometric"}
    files = {"edges:0-1;1-2", "file:PATH", "directed:PATH", *entries("GRAPHS")}
    assert set(graph_names()) == set(graphs._BUILDERS) | of_a_shape | files


def test_every_name_builds_its_graph(tmp_path):
    file = tmp_path / "ring.edges"
    concrete = {
        "K-regular": "4-regular",
        "edges:0-1;1-2": "edges:0-1;1-2;2-3;3-4;4-5",
        "file:PATH": f"file:{file}",
        "directed:PATH": f"directed:{file}",
        "intel-lab": f"intel-lab:{tmp_path}",
        "intel-lab-directed": f"intel-lab-directed:{tmp_path}",
    }
    (tmp_path / "mote_loc.txt").write_text("".join(f"{i} {i} 0\n" for i in range(1, 7)))
    pairs = [(i, j) for i in range(1, 7) for j in range(1, 7) if abs(i - j) == 1]
    (tmp_path / "connectivity.txt").write_text("".join(f"{i} {j} 0.5\n" for i, j in pairs))
    file.write_text("0 1\n1 2\n2 3\n3 4\n4 5\n5 0\n1 0\n2 1\n3 2\n4 3\n5 4\n0 5\n")
    for name in graph_names():
        assert_graph(build_graph(concrete.get(name, name), 6, seed=0), 6)
    assert same(build_graph(concrete["file:PATH"], 6, seed=0), ring(6))
    assert same(build_graph("grid", 6, seed=0), grid(2, 3))


def test_positions_decide_a_geometric_graph():
    positions = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])
    assert same(build_graph("geometric", 3, 0, positions, 100.0), path(3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ring(0), "needs at least 1"),
        (lambda: grid(0, 3), "side"),
        (lambda: regular(5, 3, 0), "product even"),
        (lambda: small_world(4, 4, 0.1, 0), "at least 5 nodes"),
        (lambda: small_world(9, 3, 0.1, 0), "even"),
        (lambda: small_world(9, 4, 1.5, 0), "between 0 and 1"),
        (lambda: scale_free(2, 2, 0), "at least 3 nodes"),
        (lambda: erdos_renyi(9, -0.1, 0), "between 0 and 1"),
        (lambda: erdos_renyi(9, 0.0, 0), "none of 1000 draws was connected"),
        (lambda: scatter(9, 0, 0.01), "raise the radius"),
        (lambda: geometric(np.zeros(3), 1.0), r"shape \(3,\)"),
        (lambda: geometric(np.full((3, 2), np.nan), 1.0), "finite"),
        (lambda: geometric(np.zeros((3, 2)), 0.0), "above 0"),
        (lambda: build_graph("geometric", 3, 0, np.zeros((3, 2))), "without a radius"),
        (lambda: build_graph("geometric", 4, 0, np.zeros((3, 2)), 1.0), "3 positions for 4 nodes"),
        (lambda: build_graph("rign", 5, 0), "did you mean 'ring'.*scale-free"),
        (lambda: build_graph("four-regular", 5, 0), "did you mean 'K-regular'"),
    ],
)
def test_impossible_graphs_are_refused_with_a_cure(call, message):
    with pytest.raises(ValueError, match=message):
        call()
