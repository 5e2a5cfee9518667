"""Rounds at all nodes of many runs: sums along links against loops, and whatever way they go."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.vectorised import COV, simulate
from nodes import vectorised_mixing
from nodes.vectorised_links import Shares, links_of
from nodes.vectorised_mixing import FEW_NODES, mixed, weighed
from scenarios.setup import prepare
from tests.experiments.support import scenario

SIZES = st.one_of(st.integers(1, 9), st.just(FEW_NODES + 1))


def by_age(base: np.ndarray, ages: np.ndarray) -> np.ndarray:
    """Some rule in which ages count; a node and a silent neighbour may weigh nothing."""
    return base * np.where(ages < 0, 0.0, 0.5**ages)


@given(SIZES, st.integers(1, 3), st.booleans(), st.booleans(), st.booleans(), st.integers(0, 999))
def test_a_round_is_a_weighted_sum_over_who_is_heard(nodes, runs, perfect, alike, same, seed):
    generator = np.random.default_rng(seed)
    hears = generator.random((nodes, nodes)) < 3 / nodes
    np.fill_diagonal(hears, False)
    neighbours = [np.flatnonzero(row).tolist() for row in hears]
    links = links_of(neighbours, perfect)
    count, slots = len(links.sender), len(links.source)
    base = Shares(generator.random((1, nodes)), generator.random((1, count)))
    ages = generator.integers(-1, 3, (1 if alike else runs, count))
    own = generator.standard_normal((runs, nodes, 5))
    held = own if same and perfect else generator.standard_normal((runs, slots, 5))

    sums = mixed(weighed(links, base, ages, by_age), own, held)

    expected = base.own[..., None] * own
    everywhere = np.broadcast_to(ages, (runs, count))
    for run in range(runs):
        for link, (receiver, slot) in enumerate(zip(links.receiver, links.slot, strict=True)):
            weight = by_age(base.link[0, link], everywhere[run, link])
            expected[run, receiver] += weight * held[run, slot]
    np.testing.assert_allclose(sums, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    "asked", [{"rounds": 4, "determinant_weights": False}, {"rounds": 4}, {"rule": "wac"}]
)
def test_few_nodes_and_many_go_different_ways_to_the_same_beliefs(asked, monkeypatch):
    """Few nodes take the rounds of a step as one product where they can, many take each."""
    setup = prepare(scenario("target-crossing", nodes=9, steps=12, seed=3, **asked))
    few = simulate(setup, range(4), keep=(COV,))
    monkeypatch.setattr(vectorised_mixing, "FEW_NODES", 0)
    many = simulate(setup, range(4), keep=(COV,))
    assert few.cov is not None and many.cov is not None
    np.testing.assert_allclose(few.mean, many.mean, rtol=1e-12, atol=1e-10)
    np.testing.assert_allclose(few.cov, many.cov, rtol=1e-10, atol=1e-10)
