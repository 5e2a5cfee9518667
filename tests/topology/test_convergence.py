"""Predicted factors against brute force over all link states, closed forms and simulation."""

import itertools
import math

import numpy as np
import pytest
from scipy.sparse import csr_array

from concord.topology.convergence import (
    averaging,
    cycle_factor,
    links_with,
    mean_square_bound,
    mean_square_factor,
    measured_factor,
    rounds_to_settle,
)
from concord.topology.graphs import build_graph, complete, path, ring, star
from concord.topology.spectrum import second_eigenvalue_modulus
from concord.topology.weights import equal_neighbour, metropolis


def realised(links, up):
    """W of one state of the links, entry by entry."""
    weights = np.eye(links.nodes)
    for i, j, w, is_up in zip(links.hearer, links.heard, links.weight, up, strict=True):
        if is_up:
            weights[i, j] += w
            weights[i, i] -= w
    return weights


def by_enumeration(links):
    """E[PW (x) PW] over all states of the links, and E[W'PW]."""
    n = links.nodes
    project = np.eye(n) - 1 / n
    squared, left = np.zeros((n * n, n * n)), np.zeros((n, n))
    pairs = links.pair.max() + 1
    chance = np.zeros(pairs)
    chance[links.pair] = links.delivery
    for state in itertools.product((False, True), repeat=pairs):
        weights = realised(links, np.array(state)[links.pair])
        probability = np.where(state, chance, 1 - chance).prod()
        squared += probability * np.kron(project @ weights, project @ weights)
        left += probability * weights.T @ project @ weights
    factor = math.sqrt(np.abs(np.linalg.eigvals(squared)).max())
    centred = project @ left @ project
    return factor, math.sqrt(np.linalg.eigvalsh(centred).max())


ONE_WAY = csr_array(np.array([[0, 1, 0, 0], [0, 0, 1, 1], [1, 0, 0, 0], [1, 0, 1, 0]], dtype=bool))


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize(
    "weights",
    [metropolis(path(4)), metropolis(star(4)), equal_neighbour(path(4)), equal_neighbour(ONE_WAY)],
)
def test_second_moments_are_those_of_all_link_states_together(weights, together):
    hearers = (weights - csr_array(np.diag(weights.diagonal()))).nnz
    chances = np.full(hearers, 0.6) if together else np.linspace(0.3, 0.9, hearers)
    links = links_with(weights, chances, together=together)
    factor, bound = by_enumeration(links)
    assert mean_square_factor(links) == pytest.approx(factor, rel=1e-8)
    assert mean_square_bound(links) == pytest.approx(bound, rel=1e-8)
    assert factor <= bound * (1 + 1e-9)


@pytest.mark.parametrize("graph", [ring(9), path(7), build_graph("geometric", 30, 2)])
def test_perfect_links_fall_back_on_the_second_eigenvalue(graph):
    links = links_with(metropolis(graph), 1.0)
    modulus = second_eigenvalue_modulus(metropolis(graph))
    assert mean_square_factor(links) == pytest.approx(modulus, rel=1e-8)
    assert mean_square_bound(links) == pytest.approx(modulus, rel=1e-8)


def test_two_nodes_have_a_closed_form():
    """Both directions at once: nothing is left when the link is up, all when it is down."""
    links = links_with(metropolis(path(2)), 0.75, together=True)
    assert mean_square_factor(links) == pytest.approx(math.sqrt(0.25))


def test_a_cycle_of_graphs_is_the_product_of_its_rounds():
    phases = [metropolis(ring(6)), metropolis(star(6)), metropolis(path(6))]
    product = phases[2].toarray() @ phases[1].toarray() @ phases[0].toarray()
    moduli = np.sort(np.abs(np.linalg.eigvals(product)))
    assert cycle_factor(phases) == pytest.approx(moduli[-2] ** (1 / 3))
    assert cycle_factor([metropolis(ring(6))]) == pytest.approx(
        second_eigenvalue_modulus(metropolis(ring(6)))
    )


@pytest.mark.parametrize(
    ("name", "delivery", "together"),
    [("ring", 1.0, False), ("ring", 0.5, False), ("star", 0.7, True), ("geometric", 0.8, False)],
)
def test_what_is_measured_is_what_is_predicted(name, delivery, together):
    links = links_with(metropolis(build_graph(name, 12, 3)), delivery, together=together)
    predicted = mean_square_factor(links)
    generator = np.random.default_rng(5)
    rounds = rounds_to_settle(predicted, 1000)
    measured = measured_factor(averaging(links, generator), 12, 200, rounds, generator)
    # Batches of a chain are nearly independent; twice their interval allows for what is left.
    slack = 2 * (measured.high - measured.low) + 1e-3 * (1 - predicted)
    assert abs(measured.factor - predicted) < slack
    assert measured.low <= measured.factor <= measured.high
    assert measured.high - measured.low < 0.03


@pytest.mark.parametrize(
    ("factor", "most", "rounds"),
    [(0.0, 500, 60), (0.9, 500, 300), (0.999, 500, 500), (1.0, 70, 70)],
)
def test_rounds_to_settle_lie_between_sixty_and_the_most(factor: float, most: int, rounds: int):
    assert rounds_to_settle(factor, most) == pytest.approx(rounds, abs=1)
    assert rounds_to_settle(factor, most) <= most


def test_agreement_at_once_is_measured_as_zero():
    links = links_with(metropolis(complete(5)), 1.0)
    generator = np.random.default_rng(1)
    measured = measured_factor(averaging(links, generator), 5, 10, 100, generator)
    assert measured.factor < 1e-6
