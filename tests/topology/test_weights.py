"""Weights: doubly stochastic, within the graph, and as good as theory says."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from concord.topology import weights as weights_by_name
from concord.topology.graphs import build_graph, complete, grid, path, ring, star
from concord.topology.names import WEIGHTS
from concord.topology.spectrum import contraction_per_round, second_eigenvalue_modulus
from concord.topology.weights import (
    best_constant,
    build_weights,
    check_doubly_stochastic,
    check_weights,
    equal_neighbour,
    fastest_mixing,
    maximum_degree,
    metropolis,
)

CONNECTED = st.builds(
    build_graph,
    name=st.sampled_from(["ring", "path", "star", "complete", "erdos-renyi", "geometric"]),
    nodes=st.integers(2, 16),
    seed=st.integers(0, 10**6),
)


@given(adjacency=CONNECTED)
@settings(deadline=None)
def test_closed_forms_are_doubly_stochastic_and_stay_on_the_graph(adjacency):
    linked = adjacency.toarray()
    allowed = linked | np.eye(len(linked), dtype=bool)
    for name in ("metropolis", "maximum-degree", "best-constant"):
        weights = build_weights(name, adjacency).toarray()
        np.testing.assert_allclose(weights.sum(axis=0), 1, atol=1e-12)
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
        assert not weights[~allowed].any()
        assert (weights[linked] > 0).all()


@given(adjacency=CONNECTED)
@settings(deadline=None)
def test_local_rules_are_positive_and_primitive(adjacency):
    """Some power without a zero is primitivity by its definition (Wielandt bounds the power)."""
    nodes = adjacency.shape[0]
    for rule in (metropolis, maximum_degree):
        weights = rule(adjacency)
        assert (weights.diagonal() > 0).all()
        assert (np.linalg.matrix_power(weights.toarray(), (nodes - 1) ** 2 + 1) > 0).all()
        check_weights(weights, adjacency)


def test_metropolis_follows_its_definition_entry_by_entry():
    adjacency = build_graph("erdos-renyi", 9, 4)
    degree = [sum(row) for row in adjacency.toarray().tolist()]
    weights = metropolis(adjacency)
    for i, j in itertools.product(range(9), repeat=2):
        if adjacency[i, j]:
            assert weights[i, j] == pytest.approx(1 / (1 + max(degree[i], degree[j])))
    # Different degrees meet here, so that the maximum matters.
    assert len(set(degree)) > 2


@given(adjacency=CONNECTED)
@settings(deadline=None)
def test_the_best_constant_is_the_best_constant(adjacency):
    best = second_eigenvalue_modulus(best_constant(adjacency))
    assert best <= second_eigenvalue_modulus(maximum_degree(adjacency)) + 1e-9
    linked = adjacency.toarray()
    laplacian = np.diag(linked.sum(axis=1)) - linked
    for weight in np.linspace(0, 2 / len(linked), 50):
        other = np.eye(len(linked)) - weight * laplacian
        assert best <= second_eigenvalue_modulus(other) + 1e-9


@pytest.mark.parametrize(
    ("adjacency", "modulus"),
    [(ring(8), 0.805), (path(8), 0.949), (complete(8), 0.0)],
)
def test_metropolis_on_eight_nodes_has_the_published_second_eigenvalue(adjacency, modulus):
    """../shared/spec/consensus.md section 3.1; the ring is also (1 + 2 cos(pi / 4)) / 3."""
    assert second_eigenvalue_modulus(metropolis(adjacency)) == pytest.approx(modulus, abs=5e-4)


def test_all_weights_that_can_be_built_are_among_the_names():
    assert set(WEIGHTS) == set(weights_by_name._RULES)


def test_a_complete_graph_agrees_in_one_round_by_every_rule():
    for name in WEIGHTS:
        atol = 1e-6 if name == "fastest-mixing" else 1e-12
        np.testing.assert_allclose(build_weights(name, complete(7)).toarray(), 1 / 7, atol=atol)


def test_the_hub_of_a_star_gets_a_negative_best_constant_which_is_refused():
    """lambda_2 = 1 and lambda_n = n, so the hub keeps 1 - 2 (n - 1) / (n + 1) of its own."""
    weights = best_constant(star(6))
    assert weights[0, 0] == pytest.approx(1 - 2 * 5 / 7)
    with pytest.raises(ValueError, match=r"entry \(0, 0\) is -0\.429.*below 0.*use metropolis"):
        check_weights(weights, star(6))


def test_one_node_keeps_all_its_weight():
    for name in WEIGHTS:
        np.testing.assert_allclose(build_weights(name, ring(1)).toarray(), [[1.0]], atol=1e-12)
        check_weights(build_weights(name, ring(1)), ring(1))


def test_best_constant_needs_a_connected_graph():
    with pytest.raises(ValueError, match="2 pieces"):
        best_constant(csr_array((2, 2), dtype=bool))


def test_an_unknown_rule_offers_the_nearest():
    with pytest.raises(ValueError, match=r"did you mean 'metropolis'.*best-constant"):
        build_weights("metropolys", ring(4))


def moved(weights, changes):
    """A copy with `changes` added at (row, column)."""
    copy = weights.toarray()
    for place, change in changes.items():
        copy[place] += change
    return csr_array(copy)


FAIR = metropolis(ring(4))
TWO_PAIRS = csr_array(np.kron(np.eye(2), np.full((2, 2), 0.5)))


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (FAIR[:3], r"shape \(3, 4\) for 4 nodes"),
        (moved(FAIR, {(0, 0): np.nan}), "finite"),
        (moved(FAIR, {(0, 1): -0.5, (0, 0): 0.5}), r"entry \(0, 1\).*below 0"),
        (moved(FAIR, {(1, 1): 0.1}), "row 1 sums to 1.1"),
        (
            moved(FAIR, {(0, 2): 0.1, (2, 0): 0.1, (0, 0): -0.1, (2, 2): -0.1}),
            r"entry \(0, 2\).*node 0 does not hear node 2",
        ),
        (TWO_PAIRS, "not primitive"),
        (csr_array(np.roll(np.eye(4), 1, axis=1)), "not primitive"),
        (csr_array(ring(4) / 2), "not primitive"),
    ],
)
def test_each_broken_rule_is_named(weights, message):
    with pytest.raises(ValueError, match=message):
        check_weights(weights, ring(4))


def test_an_odd_ring_is_primitive_without_own_weights():
    """Aperiodic by its odd cycle: the check must not ask for a positive diagonal."""
    check_weights(csr_array(ring(5) / 2), ring(5))


def test_weights_that_do_not_keep_the_average_are_refused_by_name():
    check_doubly_stochastic(FAIR)
    with pytest.raises(ValueError, match=r"column 0 sums to 0\.9.*metropolis"):
        check_doubly_stochastic(moved(FAIR, {(1, 1): 0.1, (1, 0): -0.1}))


@pytest.mark.parametrize("graph", [path(8), star(6), grid(2, 4)])
def test_fastest_mixing_is_sound_and_no_other_symmetric_weights_mix_faster(graph):
    weights = fastest_mixing(graph)
    check_weights(weights, graph)
    check_doubly_stochastic(weights)
    best = contraction_per_round(weights)
    for rival in (metropolis(graph), maximum_degree(graph)):
        assert best <= contraction_per_round(rival) + 1e-7
    # Optimality: a small step in any admissible direction does not help (the problem is convex).
    generator = np.random.default_rng(3)
    weights = weights.toarray()
    for _ in range(50):
        step = np.where(graph.toarray(), generator.normal(size=graph.shape), 0.0)
        step = 1e-3 * (step + step.T)
        moved_weights = weights + step - np.diag(step.sum(axis=1))
        if moved_weights.min() >= 0:
            assert contraction_per_round(moved_weights) >= best - 1e-7


def test_fastest_mixing_of_a_path_has_the_factor_of_the_literature():
    """On a path of n nodes no symmetric chain mixes faster than cos(pi / n) (Boyd, Diaconis, Sun,
    Xiao 2006, Fastest mixing Markov chain on a path)."""
    assert contraction_per_round(fastest_mixing(path(8))) == pytest.approx(
        np.cos(np.pi / 8), abs=1e-6
    )


@given(adjacency=CONNECTED)
@settings(deadline=None)
def test_equal_neighbour_leads_to_its_left_eigenvector(adjacency):
    weights = equal_neighbour(adjacency)
    check_weights(weights, adjacency)
    # On an undirected graph the limit weighs a node by the number it hears, itself included.
    worth = adjacency.toarray().sum(axis=1) + 1.0
    limit = np.linalg.matrix_power(weights.toarray(), 4096)
    np.testing.assert_allclose(limit, np.tile(worth / worth.sum(), (len(worth), 1)), atol=1e-6)


def test_a_directed_ring_agrees_only_with_row_stochastic_weights():
    one_way = csr_array(np.roll(np.eye(5, dtype=bool), 1, axis=1))
    check_weights(equal_neighbour(one_way), one_way)
    cut = csr_array(np.triu(one_way.toarray()))  # a one-way path: no node hears node 0
    with pytest.raises(ValueError, match="not primitive"):
        check_weights(equal_neighbour(cut), cut)
