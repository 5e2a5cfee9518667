"""Twenty graph files of ten tools, each a path of three nodes as the tool writes it."""

import re
from pathlib import Path

import numpy as np
import pytest

from concord.topology.graph_files import read_network
from concord.topology.graphs import path

XML = '<?xml version="1.0" encoding="utf-8"?>\n'
GRAPHML = XML + '<graphml xmlns="http://graphml.graphdrawing.org/xmlns">'
FILES: list[tuple[str, str, str, str]] = [
    ("networkx", "edges.edgelist", "0 1 {}\n1 2 {}\n", ""),
    ("networkx", "weighted.edgelist", "0 1 {'weight': 3.0}\n1 2 {'weight': 4.5}\n", "not used"),
    ("networkx", "data.json",
     '{"directed": false, "multigraph": false, "graph": {}, "nodes": [{"id": 0}, {"id": 1}, '
     '{"id": 2}], "links": [{"source": 0, "target": 1}, {"source": 1, "target": 2}]}', ""),
    ("networkx", "written.graphml",
     GRAPHML + '<graph edgedefault="undirected"><node id="0"/><node id="1"/><node id="2"/>'
     '<edge source="0" target="1"/><edge source="1" target="2"/></graph></graphml>', ""),
    ("yEd", "drawn.graphml",
     GRAPHML + '<graph edgedefault="directed" id="G"><node id="n0"/><node id="n1"/><node id="n2"/>'
     '<edge id="e0" source="n0" target="n1"/><edge id="e1" source="n1" target="n2"/>'
     "</graph></graphml>", "2 of its 2 directed edges have no opposite and are taken both ways"),
    ("Gephi", "saved.gexf",
     XML + '<gexf xmlns="http://gexf.net/1.3" version="1.3"><graph defaultedgetype="undirected">'
     '<nodes><node id="0"/><node id="1"/><node id="2"/></nodes><edges>'
     '<edge id="0" source="0" target="1"/><edge id="1" source="1" target="2"/>'
     "</edges></graph></gexf>", ""),
    ("Gephi", "table.csv",
     "Source,Target,Type,Id,Label,Weight\n0,1,Undirected,0,,1.0\n1,2,Undirected,1,,1.0\n",
     "columns .* are not read"),
    ("Pajek", "edges.net", '*Vertices 3\n1 "a"\n2 "b"\n3 "c"\n*Edges\n1 2 1\n2 3 1\n', "from 0"),
    ("Pajek", "arcs.net", '*Vertices 3\n1 "a"\n2 "b"\n3 "c"\n*Arcs\n1 2\n2 3\n', "both ways"),
    ("D3", "force.json",
     '{"nodes": [{"id": "a"}, {"id": "b"}, {"id": "c"}], "links": [{"source": "a", '
     '"target": "b", "value": 5}, {"source": "b", "target": "c", "value": 1}]}',
     "from 0 for a to 2 for c"),
    ("SNAP", "email.txt",
     "# Undirected graph: ../../data/email.txt\n# Nodes: 3 Edges: 2\n# FromNodeId\tToNodeId\n"
     "10\t20\n20\t30\n", "from 0 for 10 to 2 for 30"),
    ("SNAP", "loops.txt", "# FromNodeId ToNodeId\n0\t1\n1\t1\n1\t2\n", "from a node to itself"),
    ("KONECT", "out.tsv", "% sym unweighted\n% 2 3 3\n1 2\n2 3\n", "from 0 for 1 to 2 for 3"),
    ("SuiteSparse", "pattern.mtx",
     "%%MatrixMarket matrix coordinate pattern symmetric\n% comment\n3 3 2\n2 1\n3 2\n", ""),
    ("SuiteSparse", "real.mtx",
     "%%MatrixMarket matrix coordinate real symmetric\n3 3 2\n2 1 4.0\n3 2 7.5\n", "not used"),
    ("Topology Zoo", "Zoo.gml",
     'graph [\n  directed 0\n  Network "Zoo"\n  node [\n    id 0\n    label "A"\n    Longitude 4.0'
     '\n    Latitude 52.0\n  ]\n  node [\n    id 1\n    label "B"\n    Longitude 4.1\n    Latitude '
     '52.1\n  ]\n  node [\n    id 2\n    label "C"\n    Longitude 4.2\n    Latitude 52.0\n  ]\n'
     "  edge [\n    source 0\n    target 1\n  ]\n  edge [\n    source 1\n    target 2\n  ]\n]\n",
     ""),
    ("igraph", "written.gml",
     "Creator \"igraph\"\nVersion 1\ngraph\n[\n  directed 0\n  node\n  [\n    id 0\n  ]\n  node\n  "
     "[\n    id 1\n  ]\n  node\n  [\n    id 2\n  ]\n  edge\n  [\n    source 1\n    target 0\n  ]\n"
     "  edge\n  [\n    source 2\n    target 1\n  ]\n]\n", ""),
    ("igraph", "written.edges", "0 1\n1 2\n", ""),
    ("numpy", "matrix.txt", "0 1 0\n1 0 1\n0 1 0\n", ""),
    ("spreadsheet", "links.csv", "source,target\na,b\nb,c\n", "from 0 for a to 2 for c"),
]  # fmt: skip


def test_there_are_twenty_files_of_ten_tools():
    assert len(FILES) == 20 and len({tool for tool, *_ in FILES}) >= 10


@pytest.mark.parametrize(
    ("tool", "name", "text", "note"), FILES, ids=[f"{t}-{n}" for t, n, *_ in FILES]
)
def test_a_file_of_a_tool_is_read(tool: str, name: str, text: str, note: str, tmp_path: Path):
    file = tmp_path / name
    file.write_text(text)
    network = read_network(file)
    assert network.adjacency.shape == (3, 3)
    assert np.array_equal(network.adjacency.toarray(), path(3).toarray()), tool
    told = "\n".join(network.notes)
    assert re.search(note, told) if note else not told
    assert (network.positions is not None) == (name == "Zoo.gml")
