"""Analysis: predictions against what iterated averaging really does."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from concord.plants.placement import place_sensors
from concord.topology.analysis import (
    analyse,
    components,
    require_connected,
    rounds_to,
)
from concord.topology.geometric_graphs import geometric
from concord.topology.graphs import build_graph, complete, grid, path, ring, star
from concord.topology.spectrum import contraction_per_round, second_eigenvalue_modulus
from concord.topology.weights import best_constant, maximum_degree, metropolis

CONNECTED = st.builds(
    build_graph,
    name=st.sampled_from(["ring", "path", "star", "erdos-renyi", "geometric", "scale-free"]),
    nodes=st.integers(3, 16),
    seed=st.integers(0, 10**6),
)


def left_by(weights, rounds):
    """The largest part of a disagreement that survives, by simulation of a basis of them."""
    nodes = weights.shape[0]
    beginnings = np.eye(nodes) - 1 / nodes
    for _ in range(rounds):
        beginnings = weights @ beginnings
    return np.linalg.svd(beginnings, compute_uv=False)[0]


@pytest.mark.parametrize("rule", [metropolis, maximum_degree, best_constant])
@given(adjacency=CONNECTED)
@settings(deadline=None, max_examples=25)
def test_disagreement_falls_at_the_predicted_rate(rule, adjacency):
    """From the worst beginning L rounds leave factor^L."""
    weights = rule(adjacency)
    factor = second_eigenvalue_modulus(weights)
    for rounds in (1, 2, 3, 10):
        assert left_by(weights, rounds) == pytest.approx(factor**rounds, rel=1e-9, abs=1e-12)


def test_rounds_to_one_percent_are_those_of_the_reference_networks():
    """../shared/spec/consensus.md section 3.1 has 22 for the ring of eight nodes, and 88 for the
    path from its rounded .949; the exact (1 + 2 cos(pi / 8)) / 3 needs one more."""
    assert rounds_to(0.01, second_eigenvalue_modulus(metropolis(ring(8)))) == 22
    assert rounds_to(0.01, 0.949) == 88
    assert rounds_to(0.01, second_eigenvalue_modulus(metropolis(path(8)))) == 89
    assert rounds_to(0.01, second_eigenvalue_modulus(metropolis(complete(8)))) == 1


def test_the_tracking_network_agrees_as_slowly_as_published():
    """../shared/spec/consensus.md sections 3.1 and 4: .981, and 243 rounds from a rounded value."""
    figures = analyse(adjacency := geometric(place_sensors(20), 330.0), metropolis(adjacency))
    assert figures.second_eigenvalue_modulus == pytest.approx(0.981, abs=5e-4)
    assert figures.rounds_to_one_percent == pytest.approx(243, abs=1)


def test_directed_weights_can_contract_less_than_their_eigenvalues_say():
    """A lazy one-way ring: eigenvalues (1 + exp(2 pi i k / n)) / 2, a normal matrix, so equal; a
    product of two different averagings is not normal and its first round is worse than its rate."""
    one_way = (np.eye(5) + np.roll(np.eye(5), 1, axis=1)) / 2
    expected = math.cos(math.pi / 5)
    assert second_eigenvalue_modulus(one_way) == pytest.approx(expected)
    assert contraction_per_round(one_way) == pytest.approx(expected)
    product = metropolis(path(5)).toarray() @ metropolis(star(5)).toarray()
    assert contraction_per_round(product) > second_eigenvalue_modulus(product) + 1e-3


def test_shapes_have_their_textbook_figures():
    figures = analyse(path(5), metropolis(path(5)))
    assert figures.cut_nodes == (1, 2, 3)
    assert (figures.diameter, figures.links, figures.degree_min, figures.degree_max) == (4, 4, 1, 2)
    assert figures.degree_mean == pytest.approx(8 / 5)
    assert analyse(ring(9), metropolis(ring(9))).cut_nodes == ()
    assert analyse(star(5), metropolis(star(5))).cut_nodes == (0,)
    assert analyse(grid(3, 4), metropolis(grid(3, 4))).diameter == 5
    one = analyse(ring(1), metropolis(ring(1)))
    assert (one.diameter, one.second_eigenvalue_modulus, one.rounds_to_one_percent) == (0, 0.0, 1)


def test_a_graph_in_pieces_says_so():
    adjacency = np.zeros((5, 5), dtype=bool)
    for one, other in ((0, 3), (1, 4)):
        adjacency[one, other] = adjacency[other, one] = True
    adjacency = csr_array(adjacency)
    assert components(adjacency) == ((0, 3), (1, 4), (2,))
    figures = analyse(adjacency, metropolis(adjacency))
    assert figures.second_eigenvalue_modulus == pytest.approx(1)
    assert figures.diameter is None and figures.rounds_to_one_percent is None
    with pytest.raises(ValueError, match=r"3 pieces .*nodes 0, 3; nodes 1, 4; nodes 2.*add links"):
        require_connected(adjacency)
    require_connected(ring(5))


def test_a_directed_graph_that_does_not_lead_everywhere_says_so():
    """Node 1 hears node 0, but not the other way: two pieces, though they are linked."""
    one_way = csr_array(np.array([[0, 0], [1, 0]], dtype=bool))
    with pytest.raises(ValueError, match="2 pieces that do not all hear all"):
        require_connected(one_way)


def test_many_pieces_do_not_flood_the_message():
    with pytest.raises(ValueError, match=r"500 pieces.*and 492 more") as caught:
        require_connected(csr_array((500, 500), dtype=bool))
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("share", [0.0, 1.0, -0.1, math.nan])
def test_a_disagreement_that_is_no_share_is_refused(share):
    with pytest.raises(ValueError, match="between 0 and 1"):
        rounds_to(share, 0.5)


@given(factor=st.floats(0.001, 0.999), share=st.floats(1e-9, 0.999))
def test_the_number_of_rounds_is_the_least(factor, share):
    rounds = rounds_to(share, factor)
    assert rounds is not None
    assert factor**rounds <= share * (1 + 1e-9)
    assert rounds == 1 or factor ** (rounds - 1) > share * (1 - 1e-9)
