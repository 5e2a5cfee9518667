"""Graphs as one word: every graph comes back from its word."""

import networkx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from concord.topology.edge_text import edge_text, read_edge_text


@given(arrays(bool, st.integers(1, 6).map(lambda n: (n, n))))
def test_a_matrix_comes_back(matrix: np.ndarray):
    word = edge_text(matrix)
    np.fill_diagonal(matrix, False)
    found = read_edge_text(word.removeprefix("edges:"), len(matrix))
    assert np.array_equal(found.toarray(), matrix)


def test_an_edge_of_networkx_goes_from_who_is_heard_to_who_hears():
    assert edge_text(networkx.DiGraph([(2, 0), (0, 1), (1, 0)])) == "edges:0-1;2>0"
    assert edge_text(networkx.path_graph(3)) == "edges:0-1;1-2"
    assert read_edge_text("2>0", 3).toarray()[0].tolist() == [False, False, True]


@pytest.mark.parametrize(
    ("text", "nodes", "says"),
    [
        ("0-1;1~2", 3, "'1~2' is no edge; write 0-1"),
        ("1-1", 3, "'1-1' is no edge"),
        ("0-5", 3, "it has node 5, and the network has nodes 0 to 2; ask for --nodes 6"),
    ],
)
def test_what_is_no_graph_is_refused(text: str, nodes: int, says: str):
    with pytest.raises(ValueError, match=says.replace("~", "~")):
        read_edge_text(text, nodes)


def test_values_that_are_no_graph_are_refused():
    with pytest.raises(ValueError, match=r"shape \(2, 3\): must be square"):
        edge_text(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="convert_node_labels_to_integers"):
        edge_text(networkx.Graph([("a", "b")]))
