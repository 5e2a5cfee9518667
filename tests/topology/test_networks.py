"""Networks with chances of delivery and places: in files and in parts."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from concord.topology.adjacency import from_links, is_symmetric, links_of, neighbours_of, union
from concord.topology.analysis import analyse, components, cut_links, cut_nodes
from concord.topology.graph_files import read_network, write_network
from concord.topology.graphs import build_graph, build_network, ring, star
from concord.topology.network import Network, part_of
from concord.topology.weights import equal_neighbour


def random_network(nodes: int, seed: int) -> Network:
    generator = np.random.default_rng(seed)
    hearer, heard = np.nonzero(generator.uniform(size=(nodes, nodes)) < 0.4)
    adjacency = from_links(nodes, hearer, heard)
    delivery = generator.uniform(0.01, 1, adjacency.nnz)
    return Network(adjacency, delivery, generator.uniform(size=(nodes, 2)))


@pytest.mark.parametrize("suffix", [".edges", ".csv", ".graphml"])
@pytest.mark.parametrize("nodes", [2, 5, 12])
def test_a_directed_lossy_network_survives_its_file(tmp_path, suffix, nodes):
    network = random_network(nodes, seed=nodes)
    write_network(tmp_path / f"net{suffix}", network)
    back = read_network(tmp_path / f"net{suffix}", nodes, directed=True)
    assert (back.adjacency.toarray() == network.adjacency.toarray()).all()
    np.testing.assert_array_equal(back.delivery, network.delivery)
    if suffix == ".graphml":
        np.testing.assert_array_equal(back.positions, network.positions)


def test_numbers_that_are_no_chances_only_say_that_there_is_a_link(tmp_path):
    for text in ("0 1 3\n1 2 0.5\n", "0 1 1\n1 2 1\n", "0 1\n1 2\n"):
        (tmp_path / "net.edges").write_text(text)
        assert read_network(tmp_path / "net.edges").delivery is None


def test_a_pair_may_deliver_differently_in_its_two_directions(tmp_path):
    (tmp_path / "net.edges").write_text("0 1 0.9\n1 0 0.2\n1 2 0.5\n")
    network = read_network(tmp_path / "net.edges")
    hearer, heard = links_of(network.adjacency)
    assert network.delivery is not None
    found = {(j, i): p for i, j, p in zip(hearer, heard, network.delivery, strict=True)}
    assert found == {(0, 1): 0.9, (1, 0): 0.2, (1, 2): 0.5, (2, 1): 0.5}


def test_an_edge_list_goes_one_way_where_that_is_asked_for(tmp_path):
    (tmp_path / "net.edges").write_text("0 1\n1 2\n")
    network = read_network(tmp_path / "net.edges", directed=True)
    assert neighbours_of(network.adjacency) == [[], [0], [1]]


def test_graphml_without_a_chance_above_zero_is_refused(tmp_path):
    network = random_network(4, 1)
    write_network(tmp_path / "net.graphml", network._replace(delivery=network.delivery * 0))  # type: ignore[operator]
    with pytest.raises(ValueError, match=r"delivery 0\.0 from .* above 0"):
        read_network(tmp_path / "net.graphml", directed=True)


def test_a_part_keeps_its_links_places_and_chances():
    network = random_network(9, 3)
    kept = np.array([1, 2, 5, 8])
    part = part_of(network, kept)
    dense = csr_array((network.delivery, links_of(network.adjacency)), shape=(9, 9)).toarray()
    inner = dense[kept][:, kept]
    assert (part.adjacency.toarray() == (inner > 0)).all()
    np.testing.assert_array_equal(part.delivery, inner[links_of(part.adjacency)])
    np.testing.assert_array_equal(part.positions, network.positions[kept])  # type: ignore[index]


def test_a_union_has_the_links_of_all():
    both = union([ring(6), star(6)])
    assert (both.toarray() == (ring(6).toarray() | star(6).toarray())).all()


@pytest.mark.parametrize(
    "adjacency",
    [
        from_links(6, [0, 1, 2, 2, 3, 4, 5, 0], [1, 2, 0, 3, 4, 5, 2, 2]),
        build_graph("geometric", 18, 2),
    ],
    ids=["directed", "undirected"],
)
def test_weak_points_are_those_whose_loss_divides_the_graph(adjacency):
    dense, both_ways = adjacency.toarray(), is_symmetric(adjacency)
    nodes, links = [], []
    for node in range(len(dense)):
        rest = np.delete(np.delete(dense, node, 0), node, 1)
        if len(components(csr_array(rest))) > 1:
            nodes.append(node)
    for i, j in np.argwhere(np.triu(dense) if both_ways else dense):
        rest = dense.copy()
        rest[i, j] = False
        rest[j, i] &= not both_ways
        if len(components(csr_array(rest))) > 1:
            links.append((i, j))
    assert cut_nodes(adjacency) == tuple(nodes) and nodes
    assert cut_links(adjacency) == tuple(links) and links
    figures = analyse(adjacency, equal_neighbour(adjacency))
    assert figures.directed != both_ways and figures.weak_components == 1
    assert figures.links == dense.sum() / (1 + both_ways)


def test_nodes_may_be_left_open_only_for_what_is_read(tmp_path):
    (tmp_path / "net.edges").write_text("0 1\n")
    assert build_network(f"file:{tmp_path / 'net.edges'}", None, 1).adjacency.shape == (2, 2)
    with pytest.raises(ValueError, match="say how many with --nodes"):
        build_network("ring", None, 1)
