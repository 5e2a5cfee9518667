"""Names of nodes: each node has one."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.nodes.bounds import node_of


@given(st.integers(1, 2000), st.data())
def test_a_node_has_its_number_for_a_name_and_no_other(nodes: int, data: st.DataObject):
    node = data.draw(st.integers(0, nodes - 1))
    assert node_of(str(node), nodes) == node
    assert node_of(f"0{node}", nodes) is None
    assert node_of(str(node + nodes), nodes) is None


@pytest.mark.parametrize(
    "name", ["", "01", "00", "-1", "+1", "1.0", " 1", "1\n", "²", "١", "x", "9" * 5000]
)
def test_other_spellings_are_no_names(name: str):
    assert node_of(name, 12) is None
