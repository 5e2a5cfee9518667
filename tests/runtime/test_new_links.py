"""Processes open links to new neighbours, and give the bits of one process."""

import pytest

from concord.studies.agree import agreement
from tests.experiments.support import small

pytestmark = pytest.mark.zenoh


@pytest.mark.parametrize(
    ("beginning", "changes"),
    [
        # A link that comes, goes and comes again; a node that returns to a graph that it never saw.
        ("ring", ("3 set graph=edges:0-1;1-2;2-3;3-4;4-5;0-5;0-3", "6 set graph=path",
                  "9 set graph=edges:0-1;1-2;2-3;3-4;4-5;0-3", "11 kill 3",
                  "12 set graph=complete", "14 restart 3", "16 cut 2 5")),
        ("ring", ("3 set graph=edges:0>1;1>2;2>3;3>4;4>5;5>0;3>0 rounds=2",)),
    ],
)  # fmt: skip
def test_links_that_come_and_go_give_the_bits_of_one_process(
    beginning: str, changes: tuple[str, ...]
):
    setup = small(
        nodes=6, graph=beginning, steps=18, weights="equal-neighbour", rule="ci", changes=changes
    )
    found = agreement(setup)
    assert len(found.drivers) == 2 and not found.differences


def test_a_dense_network_takes_a_sparse_graph_over_its_router():
    changes = ("3 set graph=ring", "6 set graph=star", "9 set graph=complete")
    found = agreement(small(nodes=11, graph="complete", steps=12, changes=changes))
    assert len(found.drivers) == 2 and not found.differences
