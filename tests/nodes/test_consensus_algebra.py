"""Messages between nodes are algebra: powers of the weight matrix, and a simulation written out.

The oracles here know nothing of events: they are loops over nodes, or one matrix product.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import read_frame
from concord.bus.schedule import full_publish, hybrid, round_robin
from concord.filters.fusion.averaging import INFORMATION
from concord.filters.gaussian import Gaussian
from tests.nodes.networks import (
    DECAYED,
    DROP,
    PREDICT,
    Adjacency,
    Network,
    graphs,
    losing,
    network,
    path,
    random_priors,
    run,
)
from tests.nodes.rule_networks import F, Q, run_watched

SEEDS = st.integers(0, 2**32 - 1)


def metropolis_weights(adjacency: Adjacency) -> np.ndarray:
    """Metropolis weights, entry by entry."""
    count = len(adjacency)
    degree = [sum(row) for row in adjacency]
    weights = np.zeros((count, count))
    for i in range(count):
        for j in range(count):
            if adjacency[i, j]:
                weights[i, j] = 1 / (1 + max(degree[i], degree[j]))
        weights[i, i] = 1 - sum(weights[i])
    return weights


@given(graphs(), st.integers(1, 6), SEEDS)
@settings(max_examples=30)
def test_covariance_intersection_is_the_power_acting_on_information(
    adjacency: Adjacency, rounds: int, seed: int
):
    priors = random_priors(np.random.default_rng(seed), len(adjacency), 3)
    net = network(adjacency, priors, steps=1, rounds=rounds, average=INFORMATION, hold_policy=DROP)
    outcome = run(net)
    power = np.linalg.matrix_power(metropolis_weights(adjacency), rounds)
    matrices = np.einsum("ij,jab->iab", power, [np.linalg.inv(p.cov) for p in priors])
    vectors = power @ [np.linalg.inv(p.cov) @ p.mean for p in priors]
    np.testing.assert_allclose(outcome.cov[0], np.linalg.inv(matrices), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(
        outcome.mean[0],
        [np.linalg.solve(*pair) for pair in zip(matrices, vectors, strict=True)],
        rtol=1e-9,
        atol=1e-11,
    )


# --- lost and held shares, written out -----------------------------------------------------------


class Held(NamedTuple):
    """Held share of a neighbour."""

    belief: Gaussian
    age: int


Worth = Callable[[float, Held], float]
WORTH: dict[str, Worth] = {
    "predict": lambda weight, held: weight,
    "decayed": lambda weight, held: weight * 0.5**held.age * np.linalg.det(held.belief.cov) ** -0.5,
}


def _moved(belief: Gaussian) -> Gaussian:
    return Gaussian(F @ belief.mean, F @ belief.cov @ F.T + Q)


def _mixed(parts: list[tuple[float, Gaussian]]) -> Gaussian:
    return Gaussian(
        sum((w * b.mean for w, b in parts), np.zeros(2)),
        sum((w * b.cov for w, b in parts), np.zeros((2, 2))),
    )


def written_out(
    net: Network, priors: list[Gaussian], arrived: set[tuple[int, int, int]], name: str
) -> tuple[np.ndarray, list[list[list[int]]]]:
    """Means (steps, N, n), and ages per step and node; `arrived` are (sender, receiver, cycle)."""
    adjacency = np.zeros((len(priors), len(priors)), dtype=bool)
    for node in net.nodes:
        adjacency[node.index, list(node.neighbours)] = True
    weights = metropolis_weights(adjacency)
    own = dict(enumerate(priors))
    held: dict[tuple[int, int], Held] = {}
    means, ages = [], []
    for cycle in range(net.environment.steps * net.environment.rounds):
        if cycle and cycle % net.environment.rounds == 0:
            own = {i: _moved(belief) for i, belief in own.items()}
            held = {key: Held(_moved(h.belief), h.age) for key, h in held.items()}
        held = {key: Held(h.belief, h.age + 1) for key, h in held.items()}
        for j, i, when in arrived:
            if when == cycle:
                held[i, j] = Held(own[j], 0)
        fused = {}
        for i in own:
            heard = {j: held[i, j] for j in net.nodes[i].neighbours if (i, j) in held}
            if name == "drop":
                parts = [(weights[i, j], h.belief) for j, h in heard.items() if h.age == 0]
                parts.append((1 - sum(w for w, _ in parts), own[i]))
            else:
                heard[i] = Held(own[i], 0)
                worth = {j: WORTH[name](weights[i, j], h) for j, h in heard.items()}
                parts = [(worth[j] / sum(worth.values()), h.belief) for j, h in heard.items()]
            fused[i] = _mixed(parts)
        own = fused
        if (cycle + 1) % net.environment.rounds == 0:
            means.append([own[i].mean for i in own])
            ages.append([_ages(net, held, i) for i in own])
    return np.array(means), ages


def _ages(net: Network, held: dict[tuple[int, int], Held], i: int) -> list[int]:
    return [held[i, j].age if (i, j) in held else -1 for j in net.nodes[i].neighbours]


@given(graphs(least=2, most=5), st.integers(1, 3), st.integers(0, 2), SEEDS, st.floats(0, 0.8))
@pytest.mark.parametrize("name", ["drop", "predict", "decayed"])
@settings(max_examples=15)
def test_lost_and_held_shares_are_as_written_out(
    name: str, adjacency: Adjacency, rounds: int, kind: int, seed: int, loss: float
):
    count = len(adjacency)
    priors = random_priors(np.random.default_rng(seed), count, 2)
    schedule = (full_publish(count), round_robin(count, 1), hybrid(count, 0.6))[kind]
    net = network(
        adjacency,
        priors,
        steps=4,
        rounds=rounds,
        matrix=F,
        process_noise_cov=Q,
        hold_policy={"drop": DROP, "predict": PREDICT, "decayed": DECAYED}[name],
        schedule=schedule,
    )
    outcome, arrived = run_watched(net, losing(seed, loss))
    means, ages = written_out(net, priors, arrived, name)
    np.testing.assert_allclose(outcome.mean, means, rtol=1e-9, atol=1e-11)
    assert [e.ages for e in outcome.estimates] == [row for step in ages for row in step]


@given(graphs(least=2, most=5), SEEDS, st.floats(0, 1))
@settings(max_examples=20)
def test_what_is_sent_is_either_heard_or_missed(adjacency: Adjacency, seed: int, loss: float):
    """With static turns each node knows the due senders, so it notices each lost frame."""
    count = len(adjacency)
    priors = random_priors(np.random.default_rng(seed), count, 2)
    schedule = round_robin(count, (count + 1) // 2)
    net = network(adjacency, priors, steps=3, rounds=2, schedule=schedule)
    outcome, arrived = run_watched(net, losing(seed, loss))
    sent = [int(topic.partition("/")[2]) for topic, _ in outcome.messages if "share" in topic]
    due = sum(int(adjacency[:, sender].sum()) for sender in sent)
    assert outcome.counted("heard") == len(arrived)
    assert outcome.counted("missed") == due - len(arrived)
    assert outcome.counted("sent") == len(sent)


def test_a_share_in_several_frames_counts_only_when_it_is_complete():
    """Twelve states take three frames; any one of them lost is the share lost."""
    generator = np.random.default_rng(4)
    priors = random_priors(generator, 2, 12)
    net = network(path(2), priors, steps=1, rounds=1)
    complete = run(net)
    first = [data for topic, data in complete.messages if topic == "share/0"]
    ids = [read_frame(frame).frame_id for frame in first]
    assert len(ids) == 3
    mixed = (priors[0].mean + priors[1].mean) / 2
    np.testing.assert_allclose(complete.mean[0], [mixed, mixed], rtol=1e-12, atol=1e-12)
    assert complete.counted("sent") == 6
    assert complete.counted("heard") == 2
    for lost in range(3):
        numbers = {ids[lost]}
        link = lambda sender, receiver, frame, numbers=numbers: (  # noqa: E731
            () if read_frame(frame).frame_id in numbers else (frame,)
        )
        outcome = run(net, link)
        np.testing.assert_allclose(outcome.mean[0], [mixed, priors[1].mean], rtol=1e-12, atol=1e-12)
        assert outcome.counted("missed") == 1


@pytest.mark.parametrize("number", ["<f8", "<f4"])
def test_a_share_on_the_wire_is_the_belief_before_the_iteration(number: str):
    priors = random_priors(np.random.default_rng(0), 2, 2)
    net = network(path(2), priors, steps=1, rounds=1, number=number)
    outcome = run(net)
    shares = [data for topic, data in outcome.messages if topic.startswith("share/")]
    for frame, prior in zip(shares, priors, strict=True):
        body = read_frame(frame).data[4:]
        values = np.frombuffer(body[: 5 * np.dtype(number).itemsize], dtype=number)
        upper = prior.cov[np.triu_indices(2)]
        expected = np.concatenate([prior.mean, upper]).astype(number)
        np.testing.assert_array_equal(values, expected)
    # float32 is what the neighbour fuses, not what the node itself keeps.
    rounded = [np.asarray(p.mean, number).astype(float) for p in priors]
    expected = [
        (priors[0].mean + rounded[1]) / 2,
        (priors[1].mean + rounded[0]) / 2,
    ]
    np.testing.assert_allclose(outcome.mean[0], expected, rtol=0, atol=1e-15)
