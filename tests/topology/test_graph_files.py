"""Graph files: what is written is read back, and every mistake is named with its line."""

from pathlib import Path

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from concord.topology.adjacency import Adjacency
from concord.topology.graph_files import read_network, write_network
from concord.topology.graphs import path, ring
from concord.topology.network import Network

INTEL_LAB = Path(__file__).resolve().parents[3] / "shared/data/intel_lab/connectivity.txt"
SUFFIXES = (".edges", ".edgelist", ".txt", ".csv", ".graphml")


def read_graph(file: str | Path, nodes: int | None = None) -> Adjacency:
    return read_network(file, nodes).adjacency


def write_graph(file: str | Path, adjacency: Adjacency) -> None:
    write_network(file, Network(adjacency))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("graphs")


@pytest.mark.parametrize("suffix", SUFFIXES)
@given(nodes=st.integers(1, 14), seed=st.integers(0, 10**6), density=st.floats(0, 1))
@settings(deadline=None, max_examples=25)
def test_a_graph_survives_its_file(folder, suffix, nodes, seed, density):
    """Graphs include nodes without neighbours, and over ten nodes (names sort as numbers)."""
    upper = np.triu(np.random.default_rng(seed).uniform(size=(nodes, nodes)) < density, 1)
    adjacency = csr_array(upper | upper.T)
    write_graph(folder / f"graph{suffix}", adjacency)
    assert same(read_graph(folder / f"graph{suffix}"), adjacency)
    assert same(read_graph(folder / f"graph{suffix}", nodes), adjacency)


def same(one, other):
    return one.shape == other.shape and (one != other).nnz == 0


def write(folder, name, text):
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def test_an_edge_list_may_have_comments_qualities_and_blank_lines(folder):
    text = "# from to probability\n\n0 1 0.9\n1\t2 1e-3  # weak\n2 1 0.5\n0 2 0\n1 1 0.0\n3\n"
    adjacency = read_graph(write(folder, "qualities.txt", text)).toarray()
    assert (adjacency[:3, :3] == path(3).toarray()).all()
    assert not adjacency[3].any()


def test_a_matrix_may_hold_qualities_and_begin_with_a_byte_order_mark(folder):
    file = write(folder, "spreadsheet.csv", "\ufeff0, 0.5,0\r\n0.25,0,1\r\n0,1,0\r\n")
    assert same(read_graph(file), path(3))


def test_graphml_names_are_numbered_in_the_order_of_the_file(folder):
    graph = networkx.path_graph(["west", "middle", "east"])
    networkx.write_graphml(graph, folder / "named.graphml")
    assert same(read_graph(folder / "named.graphml"), path(3))


def test_graphml_numbers_are_the_numbers_of_the_nodes(folder):
    graph = networkx.Graph()
    graph.add_nodes_from(["2", "0", "1"])
    graph.add_edges_from([("0", "1"), ("2", "1")])
    networkx.write_graphml(graph, folder / "shuffled.graphml")
    assert same(read_graph(folder / "shuffled.graphml"), path(3))


def test_a_directed_graphml_with_both_directions_is_a_graph(folder):
    networkx.write_graphml(networkx.DiGraph(networkx.cycle_graph(5)), folder / "both.graphml")
    assert same(read_graph(folder / "both.graphml"), ring(5))


GRAPHML = (
    '<graphml xmlns="http://graphml.graphdrawing.org/xmlns">'
    '<graph edgedefault="{}">{}</graph></graphml>'
)
TWO = '<node id="a"/><node id="b"/><edge source="a" target="{}"/>'


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("loop.edges", "0 1\n1 1\n", r"loop\.edges:2: node 1 is linked to itself; remove"),
        ("wide.edges", "0 1\n0 1 2 3\n", r"wide\.edges:2: 4 columns; give two"),
        ("cut.edges", "0 1 0.5\n2\n0 2\n", r"cut\.edges:3: 2 columns, but 3 .*give every link"),
        ("mixed.edges", "0 1\n0 2 0.5\n", r"mixed\.edges:2: 3 columns, but 2 on"),
        ("word.edges", "# x\n0 one\n", r"word\.edges:2: 'one' is not a node; number"),
        ("minus.edges", "0 -1\n", r"minus\.edges:1: '-1' is not a node"),
        ("quality.edges", "0 1 good\n", r"quality\.edges:1: 'good' is not a finite number"),
        ("lost.edges", "0 1 inf\n", r"lost\.edges:1: 'inf' is not a finite number"),
        ("from_one.edges", "1 2\n2 3\n", "node 0 is missing below node 3; number .* from 0"),
        ("huge.edges", "0 1\n1 99999999999\n", "node 2 is missing below node 99999999999"),
        ("empty.edges", "# nothing\n", "no nodes; give at least one"),
        ("empty.csv", "", "no nodes; give at least one"),
        ("ragged.csv", "0,1,0\n1,0\n0,1,0\n", r"ragged\.csv:2: 2 entries in a matrix of 3 rows"),
        ("flat.csv", "0,1,0\n1,0,1\n", r"flat\.csv:1: 3 entries in a matrix of 2 rows; .*square"),
        ("word.csv", "0,1\nyes,0\n", r"word\.csv:2: 'yes' is not a finite number of 0 or more"),
        ("gap.csv", "0,\n1,0\n", r"gap\.csv:1: '' is not a finite number"),
        ("minus.csv", "0,-1\n-1,0\n", r"minus\.csv:1: '-1' is not a finite number of 0 or more"),
        ("loop.csv", "0,1\n1,2\n", r"loop\.csv:2: node 1 is linked to itself; put 0"),
        ("one_way.csv", "0,1\n0,0\n", r"one_way\.csv: 0 hears 1, but 1 does not hear 0; give"),
        ("broken.graphml", "<graphml>", "not GraphML .*export"),
        ("not.graphml", "0 1\n", "not GraphML"),
        ("loop.graphml", GRAPHML.format("undirected", TWO.format("a")), "node a is linked to its"),
        (
            "one_way.graphml",
            GRAPHML.format("directed", TWO.format("b")),
            "b hears a, but a does not",
        ),
        ("graph.dot", "graph {}", r"unknown kind of graph file '\.dot'; rename .*\.graphml"),
    ],
)
def test_a_mistake_in_a_file_is_named_with_its_place_and_cure(folder, name, text, message):
    with pytest.raises(ValueError, match=message):
        read_graph(write(folder, name, text))


@pytest.mark.skipif(not INTEL_LAB.is_file(), reason="no ../shared/data/intel_lab to read")
def test_the_bad_line_of_the_intel_lab_is_found():
    """A real list of link qualities: its first line without a quality is its only bad one."""
    bad = next(
        number
        for number, line in enumerate(INTEL_LAB.read_text().splitlines(), start=1)
        if len(line.split()) != 3
    )
    with pytest.raises(ValueError, match=rf"connectivity\.txt:{bad}: 2 columns, but 3"):
        read_graph(INTEL_LAB)


def test_a_missing_file_and_a_wrong_number_of_nodes_are_named(folder):
    with pytest.raises(ValueError, match=r"absent\.edges: no such file"):
        read_graph(folder / "absent.edges")
    file = write(folder, "three.edges", "0 1\n1 2\n")
    for asked in (2, 4):
        with pytest.raises(ValueError, match=f"3 nodes, but {asked} were asked for; ask for 3"):
            read_graph(file, asked)


def test_an_unknown_suffix_is_not_written(folder):
    with pytest.raises(ValueError, match=r"unknown kind of graph file '\.png'"):
        write_graph(folder / "graph.png", ring(4))
    assert not (folder / "graph.png").exists()


def test_a_directed_file_says_who_hears_whom(folder):
    """Row 0 of the matrix hears nodes 1 and 2; in GraphML an edge's target hears its source."""
    matrix = write(folder, "one_way.csv", "0,1,1\n0,0,1\n1,0,0\n")
    expected = [[False, True, True], [False, False, True], [True, False, False]]
    assert read_network(matrix, directed=True).adjacency.toarray().tolist() == expected
    graph = networkx.DiGraph([(1, 0), (2, 0), (2, 1), (0, 2)])
    networkx.write_graphml(graph, folder / "one_way.graphml")
    assert (
        read_network(folder / "one_way.graphml", directed=True).adjacency.toarray().tolist()
        == expected
    )
