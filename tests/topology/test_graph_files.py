"""Graph files: what is written is read back, and every mistake is named with its line."""

import json
import re
from contextlib import suppress
from pathlib import Path

import networkx
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.io import mmwrite
from scipy.sparse import csr_array

from concord.topology.adjacency import Adjacency
from concord.topology.graph_files import is_one_way, read_network, write_network
from concord.topology.graphs import path, ring
from concord.topology.network import Network

INTEL_LAB = Path(__file__).resolve().parents[3] / "shared/data/intel_lab/connectivity.txt"
CASES = Path(__file__).resolve().parents[3] / "shared/cases/network"
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
MARKET = "%%MatrixMarket matrix coordinate real {}\n% by hand\n{}"
TWO = '<node id="a"/><node id="b"/><edge source="a" target="{}"/>'


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("wide.edges", "0 1\n0 1 2 3\n", r"wide\.edges:2: 4 columns; give two"),
        ("cut.edges", "0 1 0.5\n2\n0 2\n", r"cut\.edges:3: 2 columns, but 3 .*give every link"),
        ("mixed.edges", "0 1\n0 2 0.5\n", r"mixed\.edges:2: 3 columns, but 2 on"),
        ("data.edges", "0 1 {weight}\n", r"data\.edges:1: '{weight}' is no data .*; write {}"),
        ("set.edges", "0 1 {'weight'}\n", r"set\.edges:1: .* is no data .*; write {}"),
        ("short.edges", "source target len\n0 1 5\n1 2\n", r":3: 2 columns, but the header has 3"),
        ("bare.csv", "source,target\n0,\n", r"bare\.csv:2: a node without a name; give every"),
        ("utf16.txt", "0\0 1\0", r"utf16\.txt: not text in UTF-8; save"),
        ("quality.edges", "0 1 good\n", r"quality\.edges:1: 'good' is not a finite number"),
        ("lost.edges", "0 1 inf\n", r"lost\.edges:1: 'inf' is not a finite number"),
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
        ("graph.dot", "graph {}", r"unknown kind of graph file '\.dot'; export .* \.graphml"),
        ("broken.gml", "graph [ node [ id 0 ] edge [ source 0 target 1 ] ]", "not GML .*target 1"),
        ("none.net", "*Edges\n1 2\n", r"not Pajek \(it has no line '\*Vertices N'\)"),
        ("twice.net", '*Vertices 2\n1 "a"\n2 "a"\n', "Vertices says 2, and 1 names"),
        ("lists.net", "*Vertices 3\n*Edgeslist\n1 2 3\n", r"\*edgeslist is not read; save links"),
        ("empty.json", "{}", "not node-link JSON .*'nodes' and 'links' at its top"),
        ("cut.json", '{"nodes": [', "not node-link JSON .*line 1"),
        (
            "stranger.json",
            '{"nodes": [{"id": 0}], "links": [{"source": 0, "target": 1}]}',
            "1 entries in 'nodes', but the links name 2 nodes",
        ),
        ("bare.mtx", "3 3 1\n1 2 1\n", r"not Matrix Market .*first line is"),
        ("far.mtx", MARKET.format("general", "2 2 1\n3 1 1\n"), "'3 1 1' is outside of the"),
        ("huge.mtx", MARKET.format("general", "2 2 1e12\n1 2 1\n"), "not Matrix Market .*1e12"),
        ("cut.mtx", MARKET.format("general", "2 2 2\n1 2 1\n"), "2 entries; 1 are there"),
        ("thick.mtx", MARKET.format("general", "2 2 1\n1 2 1 3\n"), "entries have 4 numbers"),
        ("nan.mtx", MARKET.format("general", "2 2 1\nnan 2 1\n"), "'nan 2 1' is outside of"),
        ("flat.mtx", MARKET.format("general", "2 3 1\n1 2 1\n"), "2 rows and 3 columns; give"),
        ("loop.mtx", MARKET.format("general", "2 2 1\n2 2 1\n"), r"entry \(2, 2\): node 2 is"),
        ("minus.mtx", MARKET.format("symmetric", "2 2 1\n2 1 -1\n"), "'-1.0' is not a finite"),
        ("way.mtx", MARKET.format("general", "2 2 1\n1 2 1\n"), "0 hears 1, .*directed:.*way.mtx"),
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


PARTS = (
    "{", "}", "{'weight'}", "1", "2", "a", ",", ";", "\t", " ", "\n", "#", "%", '"', "1e400",
    "[", "]", "graph [ node [ id 0 ] ]", "*Vertices 2", "*Arcs", "null", "\0",
    '{"nodes": [], "links": 3}', "<graphml>", "source target",
    "%%MatrixMarket matrix coordinate real general\n",
)  # fmt: skip


@given(
    st.lists(st.sampled_from(PARTS), max_size=14).map("".join),
    st.sampled_from([*SUFFIXES, ".mtx", ".gml", ".gexf", ".net", ".json"]),
)
@settings(deadline=None, max_examples=300)
@example("{}", ".csv")
@example("*Vertices 2\n1 2", ".net")
@example("0 1 {'weight'}", ".edges")
def test_any_text_is_a_graph_or_refused_in_a_sentence(folder, text, suffix):
    with suppress(ValueError):
        read_network(write(folder, f"any{suffix}", text))


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


FIVE: networkx.Graph = networkx.Graph([(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (1, 3)])
"""The graph that each tool writes below."""


def lines_of(form: str, first: int = 0) -> str:
    return "".join(form.format(a + first, b + first) + "\n" for a, b in FIVE.edges)


def by_hand(text: str):
    return lambda file: file.write_text(text)


def node_link(edges: str):
    return lambda file: file.write_text(json.dumps(networkx.node_link_data(FIVE, edges=edges)))


PANDAS = "\n".join([",a,b,c,d,e", *(
    ",".join([name, *map(str, row)])
    for name, row in zip("abcde", networkx.to_numpy_array(FIVE).astype(int), strict=True)
)])  # fmt: skip
TOOLS = {
    "networkx.graphml": lambda file: networkx.write_graphml(FIVE, file),
    "yed.graphml": lambda file: networkx.write_graphml(networkx.DiGraph(FIVE.edges), file),
    "networkx.gml": lambda file: networkx.write_gml(FIVE, file),
    "parallel.gml": by_hand(
        "graph [\n"
        + "".join(f'node [ id {n} label "same" ]\n' for n in range(5))
        + 2 * lines_of("edge [ source {} target {} ]")
        + "]\n"
    ),
    "networkx.gexf": lambda file: networkx.write_gexf(FIVE, file),
    "networkx.net": lambda file: networkx.write_pajek(FIVE, file),
    "pajek.net": by_hand(
        "% Pajek\n*Vertices 5\n"
        + "".join(f'{n} "v{n}"\n' for n in range(1, 6))
        + "*Edges\n"
        + lines_of("{} {} 1", 1)
    ),
    "nameless.net": by_hand("*Vertices 5\n*Edges\n" + lines_of("{} {}", 1)),
    "networkx.json": node_link("edges"),
    "d3.json": node_link("links"),
    "scipy.mtx": lambda file: mmwrite(file, networkx.to_scipy_sparse_array(FIVE)),
    "array.mtx": lambda file: mmwrite(file, networkx.to_numpy_array(FIVE)),
    "networkx.edgelist": lambda file: networkx.write_edgelist(FIVE, file),
    "weighted.edgelist": by_hand(lines_of("{} {} {{'weight': 1.0, 'color': '#fff'}}")),
    "pandas.csv": by_hand("source,target\n" + lines_of("{},{}")),
    "gephi.csv": by_hand("Source;Target;Type;Id\n" + lines_of("{};{};Undirected;7")),
    "own_header.tsv": by_hand("Knoten A\tKnoten B\n" + lines_of("{}\t{}")),
    "snap.txt": by_hand("# Directed graph\n# FromNodeId\tToNodeId\n" + lines_of("{}\t{}", 20)),
    "konect.txt": by_hand("% sym unweighted\n" + lines_of("{} {}", 1)),
    "names.edges": by_hand(lines_of("n{} n{}")),
    "bare.csv": by_hand(lines_of("{},{}")),
    "numpy.txt": lambda file: np.savetxt(file, networkx.to_numpy_array(FIVE)),
    "numpy.csv": lambda file: np.savetxt(file, networkx.to_numpy_array(FIVE), delimiter=","),
    "named_matrix.csv": by_hand(PANDAS),
}


@pytest.mark.parametrize("name", TOOLS)
def test_each_tool_writes_the_same_graph(folder, name):
    TOOLS[name](folder / name)
    network = read_network(folder / name)
    # Names in the order of their first edge: 0, 1, 4, 2, 3 as `FIVE.edges` lists them.
    order = [0, 1, 4, 2, 3] if name == "names.edges" else range(5)
    expected = networkx.to_numpy_array(FIVE, nodelist=order) > 0
    assert (network.adjacency.toarray() == expected).all()
    assert network.delivery is None and "not used" not in "".join(network.notes)


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".mtx"])
def test_three_nodes_may_be_a_matrix(folder, suffix):
    matrix = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]])
    file = folder / f"three{suffix}"
    if suffix == ".mtx":
        mmwrite(file, csr_array(matrix))
    else:
        np.savetxt(file, matrix, fmt="%d", delimiter="," if suffix == ".csv" else " ")
    assert same(read_graph(file), path(3))
    links = write(folder, f"links{file.suffix}", "0 1 0.5\n1 2 0.25\n2 3 1\n".replace(" ", ","))
    if suffix != ".mtx":
        assert same(read_graph(links), path(4))


def test_other_names_are_numbered_and_that_is_said(folder):
    network = read_network(write(folder, "snap.edges", "30 4\n4 -7\n"))
    assert network.names == ("-7", "4", "30") and same(network.adjacency, path(3))
    assert "numbered in order, from 0 for -7 to 2 for 30" in network.notes[0]
    assert read_network(write(folder, "plain.edges", "0 1\n")).notes == ()


def test_links_that_are_written_once_are_taken_both_ways_with_a_line(folder):
    file = write(folder, "once.graphml", GRAPHML.format("directed", TWO.format("b")))
    network = read_network(file)
    assert same(network.adjacency, path(2)) and not is_one_way(file)
    assert (
        "1 of its 1 directed edges have no opposite and are taken both ways; directed:"
        in (network.notes[-1])
    )
    one_way = read_network(file, directed=True)
    assert one_way.adjacency.nnz == 1 and "both ways" not in "".join(one_way.notes)
    networkx.write_graphml(networkx.DiGraph([(0, 1), (1, 0), (1, 2)]), folder / "mixed.graphml")
    assert is_one_way(folder / "mixed.graphml")


@pytest.mark.parametrize("order", [(0, 1), (1, 0)], ids=["arcs first", "edges first"])
def test_arcs_and_edges_of_pajek_keep_their_directions(folder, order):
    sections = ["*Arcs\n1 2 1\n", "*Edges\n2 3 1\n"]
    text = "*Vertices 3\n" + "".join(sections[k] for k in order)
    network = read_network(write(folder, "mixed.net", text), directed=True)
    expected = [[False, False, False], [True, False, True], [False, True, False]]
    assert network.adjacency.toarray().tolist() == expected


def test_weights_that_are_no_chances_are_said(folder):
    network = read_network(write(folder, "lengths.edges", "0 1 12.5\n1 2 3.5\n"))
    assert "numbers on its links (3.5 to 12.5) are not used" in network.notes[0]
    text = 'graph [ node [ id 0 ] node [ id 1 ] edge [ source 0 target 1 weight "wide" ] ]'
    assert (
        "weights of its edges are not used: 'wide'"
        in (read_network(write(folder, "wide.gml", text)).notes[0])
    )
    chances = read_network(write(folder, "chances.csv", "from,to,km,weight\n0,1,9,.5\n"))
    assert chances.delivery is not None and chances.delivery.tolist() == [0.5, 0.5]
    assert chances.notes[0].endswith("its columns km are not read")


def test_latitude_and_longitude_are_places_in_metres(folder):
    text = 'node [ id {0} label "{1}" Longitude {2} Latitude {3} ]'
    nodes = [text.format(0, "Delft", 4.0, 52.0), text.format(1, "Bonn", 4.1, 52.1)]
    network = read_network(write(folder, "zoo.gml", f"graph [ {' '.join(nodes)} ]"))
    assert network.names == ("Delft", "Bonn") and network.positions is not None
    # A degree of a great circle is 111.195 km; that of a parallel at 52.05 degrees is 68.382 km.
    np.testing.assert_allclose(np.diff(network.positions, axis=0), [[6838.2, 11119.5]], rtol=1e-4)
    nodes.append('node [ id 2 label "Satellite" ]')
    network = read_network(write(folder, "part.gml", f"graph [ {' '.join(nodes)} ]"))
    assert network.positions is None
    assert "1 of 3 nodes have no longitude and latitude" in network.notes[0]


@pytest.mark.skipif(not CASES.is_dir(), reason="no ../shared/cases/network to read")
@pytest.mark.parametrize(
    ("name", "graph", "note"),
    [
        ("yed_directed.graphml", path(3), "2 of its 2 directed edges .* taken both ways"),
        ("small.gml", path(2), "^$"),
        ("pajek.net", path(3), "from 0 for a to 2 for c"),
        ("weights.edgelist", ring(3), r"\(3.5 to 12.5\) are not used"),
        ("two_parts.graphml", csr_array(np.kron(np.eye(2), 1 - np.eye(2)) > 0), "^$"),
    ],
)
def test_the_files_that_users_brought_are_read(name, graph, note):
    network = read_network(CASES / name)
    assert same(network.adjacency, graph)
    assert re.search(note, "\n".join(network.notes))
