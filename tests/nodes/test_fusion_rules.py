"""Every fusion rule in a network of messages, against algebra that knows nothing of messages."""

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.schedule import Schedule, full_publish, hybrid, round_robin
from concord.filters import ukf
from concord.filters.fusion import hybrid_consensus
from concord.filters.fusion.packed import packed_length, unpack
from concord.filters.gaussian import Gaussian, Information, to_gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.messages import Measured, decode, from_wire
from tests.nodes.networks import (
    Adjacency,
    Network,
    Outcome,
    graphs,
    last_come,
    losing,
    path,
    random_priors,
    ring,
    run,
    shuffled,
)
from tests.nodes.rule_networks import (
    ALL,
    FRESH,
    F,
    Q,
    losing_links,
    noise_cov,
    ruled,
    run_watched,
    weight_matrix,
)

SEEDS = st.integers(0, 2**32 - 1)
COUNT = 5
COMPLETE = ~np.eye(COUNT, dtype=bool)
PRIOR = random_priors(np.random.default_rng(2), 1, 2)[0]
SEEING = [0, 1, 3]


def schedules(count: int) -> st.SearchStrategy[Schedule]:
    return st.sampled_from(
        [full_publish(count), round_robin(count, (count + 1) // 2), hybrid(count, 0.6)]
    )


def readings(outcome: Outcome) -> dict[int, dict[int, np.ndarray]]:
    """Return the readings of each seeing node at each step."""
    read: dict[int, dict[int, np.ndarray]] = {}
    for topic, data in outcome.messages:
        if topic.startswith("measured/"):
            message = decode(topic, data)
            assert isinstance(message, Measured)
            values = from_wire(message.readings)[0]
            if not np.isnan(values).any():
                read.setdefault(message.step, {})[message.node] = values
    return read


def kalman(belief: Gaussian, read: dict[int, np.ndarray]) -> Gaussian:
    """The update by the readings of some nodes at once."""
    mean, cov = belief
    for node, value in read.items():
        gain = cov @ np.linalg.inv(cov + noise_cov(node))
        mean = mean + gain @ (value - mean)
        left = np.eye(2) - gain
        cov = left @ cov @ left.T + gain @ noise_cov(node) @ gain.T
    return Gaussian(mean, cov)


def predicted(belief: Gaussian) -> Gaussian:
    return Gaussian(F @ belief.mean, F @ belief.cov @ F.T + Q)


def centralised(outcome: Outcome, steps: int) -> list[Gaussian]:
    """The Kalman filter that has all readings."""
    read, belief, beliefs = readings(outcome), PRIOR, []
    for step in range(steps):
        belief = kalman(predicted(belief) if step else belief, read[step])
        beliefs.append(belief)
    return beliefs


# --- the centralised filter ----------------------------------------------------------------------


@pytest.mark.parametrize("rule", ["centralised", "icf", "hcmci", "diffusion"])
def test_on_a_complete_graph_one_round_is_the_centralised_filter(rule: str):
    steps = 30
    outcome = run(ruled(rule, COMPLETE, [PRIOR] * COUNT, steps=steps, rounds=1, seeing=SEEING))
    for step, expected in enumerate(centralised(outcome, steps)):
        np.testing.assert_allclose(outcome.mean[step], [expected.mean] * COUNT, rtol=0, atol=1e-12)
        np.testing.assert_allclose(outcome.cov[step], [expected.cov] * COUNT, rtol=0, atol=1e-12)


# --- loss ----------------------------------------------------------------------------------------


@given(graphs(), st.integers(1, 5), st.data(), SEEDS, st.floats(0, 0.8))
@settings(max_examples=20)
def test_the_row_that_travels_is_that_of_the_weights_really_used(
    adjacency: Adjacency, rounds: int, data: st.DataObject, seed: int, loss: float
):
    """With silent nodes and lost frames, novelty counts at most once, and some exactly once."""
    count = len(adjacency)
    schedule = data.draw(schedules(count))
    priors = random_priors(np.random.default_rng(seed), count, 2)
    net = ruled("hcmci", adjacency, priors, steps=1, rounds=rounds, seeing=[0], schedule=schedule)
    outcome, arrived = run_watched(net, losing(seed, loss))
    product = np.eye(count)
    for cycle in range(rounds):
        used = weight_matrix(net) * np.eye(count)
        for sender, receiver, when in arrived:
            if when == cycle:
                used[receiver, sender] = weight_matrix(net)[receiver, sender]
        product = used / used.sum(axis=1, keepdims=True) @ product
    for i, state in enumerate(outcome.states):
        row = state.content.own.known[-count:]
        np.testing.assert_allclose(row, product[i], rtol=0, atol=1e-12)
        gain = 1 / row.max()
        assert (gain * row <= 1 + 1e-12).all()
        # The belief is what these factors make of the priors and the only reading there is.
        read = readings(outcome)[0]
        old = [np.linalg.inv(prior.cov) for prior in priors]
        matrix = np.tensordot(product[i], old, 1)
        vector = sum(a * M @ p.mean for a, M, p in zip(product[i], old, priors, strict=True))
        R = noise_cov(0)
        matrix = matrix + gain * row[0] * np.linalg.inv(R)
        vector = vector + gain * row[0] * np.linalg.solve(R, read[0])
        np.testing.assert_allclose(np.linalg.inv(outcome.cov[0, i]), matrix, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(matrix @ outcome.mean[0, i], vector, rtol=1e-7, atol=1e-8)


def with_number_of_nodes_as_gain(numbers: np.ndarray, states: int) -> Gaussian:
    """Hybrid consensus as Battistelli and others (2015) write it."""
    length = packed_length(states)
    prior, added = unpack(numbers[..., :length]), unpack(numbers[..., length : 2 * length])
    gain = numbers.shape[-1] - 2 * length
    matrix = prior.matrix + gain * added.matrix
    return to_gaussian(Information(prior.vector + gain * added.vector, matrix))


@given(graphs(least=2, most=5), st.integers(1, 3), st.data(), SEEDS, st.floats(0, 0.6))
@settings(max_examples=10)
def test_icf_is_hybrid_consensus_with_the_number_of_nodes_as_gain(
    adjacency: Adjacency, rounds: int, data: st.DataObject, seed: int, loss: float
):
    """On a full schedule without loss, and just so where shares are lost or not published."""
    count = len(adjacency)
    priors = random_priors(np.random.default_rng(seed), count, 2)
    schedule = data.draw(st.sampled_from([full_publish(count), round_robin(count, 1)]))

    def outcome(rule: str) -> Outcome:
        drawn = {"steps": 3, "rounds": rounds, "seeing": [0, 1], "schedule": schedule}
        return run(ruled(rule, adjacency, priors, **drawn), losing_links(seed, loss))

    icf = outcome("icf")
    with patch.object(hybrid_consensus, "from_information", with_number_of_nodes_as_gain):
        classical = outcome("hcmci")
    np.testing.assert_allclose(icf.mean, classical.mean, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(icf.cov, classical.cov, rtol=1e-10, atol=1e-10)


def written_out(net: Network, priors: list[Gaussian], outcome: Outcome, arrived: set, rule: str):
    """Diffusion and Kalman consensus as their papers write them, a loop over nodes.

    Returns:
        Means (steps, N, 2) and covariances (steps, N, 2, 2).
    """
    count, rounds = len(net.nodes), net.environment.rounds
    weights = weight_matrix(net)
    rate = 1 / (1 + max(len(node.neighbours) for node in net.nodes))
    read = readings(outcome)
    beliefs = list(priors)
    means, covs = [], []
    for cycle in range(net.environment.steps * rounds):
        step, round_ = divmod(cycle, rounds)
        if cycle and round_ == 0:
            beliefs = [predicted(belief) for belief in beliefs]
        fused = []
        for i in range(count):
            heard = [j for j in net.nodes[i].neighbours if (j, i, cycle) in arrived]
            own = beliefs[i]
            pull = sum((beliefs[j].mean - own.mean for j in heard), np.zeros(2))
            if round_ == 0:
                seen = {j: read[step][j] for j in [i, *heard] if j in read[step]}
                mean, cov = kalman(own, seen)
                if rule == "kcf":
                    mean = mean + rate / (np.linalg.norm(own.cov) + 1) * own.cov @ pull
            elif rule == "kcf":
                mean, cov = own.mean + rate * pull, own.cov
            else:
                total = sum(weights[i, j] for j in [i, *heard])
                mean = sum(weights[i, j] / total * beliefs[j].mean for j in [i, *heard])
                cov = own.cov
            fused.append(Gaussian(np.asarray(mean), cov))
        beliefs = fused
        if round_ == rounds - 1:
            means.append([belief.mean for belief in beliefs])
            covs.append([belief.cov for belief in beliefs])
    return np.array(means), np.array(covs)


@given(graphs(least=2, most=5), st.integers(1, 3), st.data(), SEEDS, st.floats(0, 0.6))
@pytest.mark.parametrize("rule", ["kcf", "diffusion"])
@settings(max_examples=10)
def test_diffusion_and_kalman_consensus_are_as_written_out(
    rule: str, adjacency: Adjacency, rounds: int, data: st.DataObject, seed: int, loss: float
):
    count = len(adjacency)
    priors = random_priors(np.random.default_rng(seed), count, 2)
    net = ruled(
        rule,
        adjacency,
        priors,
        steps=4,
        rounds=rounds,
        seeing=[0, count - 1],
        schedule=data.draw(schedules(count)),
    )
    outcome, arrived = run_watched(net, losing(seed, loss))
    means, covs = written_out(net, priors, outcome, arrived, rule)
    np.testing.assert_allclose(outcome.mean, means, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(outcome.cov, covs, rtol=1e-7, atol=1e-8)


# --- what every rule promises --------------------------------------------------------------------


@given(st.sampled_from(ALL), st.data(), st.floats(0, 0.7), SEEDS)
@settings(max_examples=20)
def test_any_order_of_arrival_gives_the_same_bits(
    rule: str, data: st.DataObject, loss: float, seed: int
):
    adjacency = data.draw(graphs(least=2, most=5))
    count = len(adjacency)
    net = ruled(
        rule,
        adjacency,
        random_priors(np.random.default_rng(seed), count, 2),
        steps=3,
        rounds=2,
        seeing=[0],
        schedule=data.draw(schedules(count)),
    )
    link = losing(seed, loss)
    first_come = run(net, link)
    for pick in (shuffled(seed), last_come):
        outcome = run(net, link, pick)
        assert outcome.same_bits(first_come)
        assert [e.ages for e in outcome.estimates] == [e.ages for e in first_come.estimates]


@given(graphs(least=2, most=5), st.data(), SEEDS, st.floats(0, 1))
@pytest.mark.parametrize("rule", FRESH)
@settings(max_examples=12)
def test_agreeing_nodes_without_readings_stay_agreed_under_any_loss(
    rule: str, adjacency: Adjacency, data: st.DataObject, seed: int, loss: float
):
    count = len(adjacency)
    schedule = data.draw(schedules(count))
    net = ruled(rule, adjacency, [PRIOR] * count, steps=4, rounds=3, seeing=[], schedule=schedule)
    outcome = run(net, losing(seed, loss), shuffled(seed))
    belief = PRIOR
    for step in range(4):
        belief = predicted(belief) if step else belief
        np.testing.assert_allclose(outcome.mean[step], [belief.mean] * count, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(outcome.cov[step], [belief.cov] * count, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rule", [name for name in FRESH if name != "icf"])
def test_who_hears_nobody_is_the_local_filter(rule: str):
    """Rule icf differs: it multiplies its own novelty by the number of nodes all the same."""
    net = ruled(rule, path(3), [PRIOR] * 3, steps=12, rounds=2, seeing=[0, 1])
    deaf = run(net, lambda sender, receiver, frame: ())
    alone = run(ruled("local", path(3), [PRIOR] * 3, steps=12, rounds=2, seeing=[0, 1]))
    np.testing.assert_allclose(deaf.mean, alone.mean, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(deaf.cov, alone.cov, rtol=1e-10, atol=1e-12)
    assert deaf.counted("missed") == 4 * 2 * 12


def test_local_is_the_filter_alone_bit_for_bit():
    steps = 25
    outcome = run(ruled("local", ring(4), [PRIOR] * 4, steps=steps, rounds=2, seeing=[0, 2]))
    read, points = readings(outcome), scaled_unscented(2)
    for node in range(4):
        belief = PRIOR
        for step in range(steps):
            if step:
                # One lane of a batch: a product of other shape may round otherwise.
                lane = Gaussian(belief.mean[None], belief.cov[None])
                mean, cov = ukf.predict(lane, lambda x: x @ F.T, Q, points)
                belief = Gaussian(mean[0], cov[0])
            if node in read[step]:
                R = noise_cov(node)
                belief = ukf.update(belief, read[step][node], lambda x: x, R, points).belief
            assert outcome.mean[step, node].tobytes() == belief.mean.tobytes()
            assert outcome.cov[step, node].tobytes() == belief.cov.tobytes()
    # It publishes all the same: the bus does not see the difference.
    assert outcome.counted("sent") == 4 * 2 * steps


@pytest.mark.parametrize("rule", FRESH)
def test_float32_on_the_wire_is_as_good_to_its_own_digits(rule: str):
    exact, rounded = (
        run(ruled(rule, COMPLETE, [PRIOR] * COUNT, steps=5, rounds=1, seeing=SEEING, number=number))
        for number in ("<f8", "<f4")
    )
    np.testing.assert_allclose(rounded.mean, exact.mean, rtol=0, atol=1e-5)
    assert not rounded.same_bits(exact)
    assert rounded.counted("rejected unsound") == 0
