"""Rounds at all nodes of many runs: sums along links against loops, and whatever way they go."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.filters.gaussian import Gaussian
from concord.nodes.lanes import mixing as batched_mixing
from concord.nodes.lanes.beliefs import BatchedBeliefs
from concord.nodes.lanes.links import Shares, links_of
from concord.nodes.lanes.mixing import FEW_NODES, mixed, weighed
from concord.runtime.batched.build import build_network
from concord.scenarios.preparation import prepare
from concord.studies.monte_carlo.simulate import COV, simulate
from tests.experiments.support import scenario

SIZES = st.one_of(st.integers(1, 9), st.just(FEW_NODES + 1))


def by_age(base: np.ndarray, ages: np.ndarray) -> np.ndarray:
    """Some rule in which ages count; a node and a silent neighbour may weigh nothing."""
    return base * np.where(ages < 0, 0.0, 0.5**ages)


@settings(max_examples=40)
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
    monkeypatch.setattr(batched_mixing, "FEW_NODES", 0)
    many = simulate(setup, range(4), keep=(COV,))
    assert few.cov is not None and many.cov is not None
    np.testing.assert_allclose(few.mean, many.mean, rtol=1e-12, atol=1e-10)
    np.testing.assert_allclose(few.cov, many.cov, rtol=1e-10, atol=1e-10)


def network(rounds: int, by_inverse_volume: bool) -> tuple[BatchedBeliefs, list[list[int]]]:
    """Seven nodes in three runs, where what is held weighs like what is fresh; a node may give all
    of its weight to others."""
    setup = prepare(
        scenario(
            "target-crossing",
            nodes=7,
            rule="ci",
            number="float64",
            schedule="full",
            rounds=rounds,
            determinant_weights=by_inverse_volume,
            decay=1.0,
        )
    )
    rule = build_network(setup, range(3)).segments[0].settings.rule
    assert isinstance(rule, BatchedBeliefs)
    base = rule.base._replace(own=np.array([[0.0, 0.2, 0.3, 0.1, 0.2, 0.5, 0.2]]))
    return replace(rule, base=base), setup.neighbours


def rounds_by_loops(
    rule: BatchedBeliefs, neighbours: list[list[int]], given: Gaussian, sends: np.ndarray, run: int
) -> Gaussian:
    """Every node by itself: those whose matrix has a negative eigenvalue say nothing."""
    beliefs = [
        (np.linalg.inv(cov), mean)
        for mean, cov in zip(given.mean[run], given.cov[run], strict=True)
    ]
    row = np.split(rule.base.link[0], rule.links.offsets[1:-1])
    held: list[dict] = [{} for _ in beliefs]
    for speaks in sends[:, run]:
        for node, others in enumerate(neighbours):
            for other in others:
                if speaks[other] and np.linalg.eigvalsh(beliefs[other][0]).min() > 0:
                    held[node][other] = beliefs[other]
        after = []
        for node, others in enumerate(neighbours):
            known = [(beliefs[node], rule.base.own[0, node])]
            known += [
                (held[node][other], weight)
                for other, weight in zip(others, row[node], strict=True)
                if other in held[node]
            ]
            used = [(one, weight) for one, weight in known if weight > 0] or [(beliefs[node], 1.0)]
            if rule.hold.by_inverse_volume:
                used = [
                    (one, w * np.linalg.det(one[0]) ** 0.25 if len(used) > 1 else w)
                    for one, w in used
                ]
            total = sum(weight for _, weight in used)
            matrix = sum(weight / total * one[0] for one, weight in used)
            vector = sum(weight / total * one[0] @ one[1] for one, weight in used)
            after.append((matrix, np.linalg.solve(matrix, vector)))
        beliefs = after
    return Gaussian(
        np.array([mean for _, mean in beliefs]),
        np.array([np.linalg.inv(matrix) for matrix, _ in beliefs]),
    )


@settings(max_examples=30)
@given(
    st.lists(st.booleans(), min_size=1, max_size=4),
    st.booleans(),
    st.booleans(),
    st.integers(0, 99),
)
def test_rounds_are_averages_whoever_is_silent_in_them(full, by_inverse_volume, broken, seed):
    generator = np.random.default_rng(seed)
    rule, neighbours = network(len(full), by_inverse_volume)
    root = generator.standard_normal((3, 7, 4, 6))
    given_ = Gaussian(generator.standard_normal((3, 7, 4)), root @ root.mT + 0.1 * np.eye(4))
    if broken:
        given_.cov[0, 0] = -np.eye(4)
    sends = generator.random((len(full), 3, 7)) < 0.5
    sends[np.array(full)] = True

    content = rule.start(given_)
    for speaks in sends:
        content = rule.exchange(content, speaks, None)
    found = rule.belief(content)

    for run in range(3):
        expected = rounds_by_loops(rule, neighbours, given_, sends, run)
        np.testing.assert_allclose(found.mean[run], expected.mean, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(found.cov[run], expected.cov, rtol=1e-8, atol=1e-8)
