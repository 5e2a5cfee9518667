"""Test the effects that a hostile network cannot have.

Order of arrival, repetition and garbage change no result. Loss does not separate nodes that agree.
"""

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.flexray.share_frames import read_frame
from bus.schedule import full_publish, hybrid, round_robin
from filters.fusion.averaging import INFORMATION, MOMENTS
from filters.gaussian import Gaussian
from nodes.faults.losses import LinkState, Outage, hears
from nodes.rules.belief_consensus import HoldPolicy
from runtime.in_process import first_come
from tests.nodes.networks import (
    DECAYED,
    HOLDS,
    PREDICT,
    SEEDS,
    TURN,
    Adjacency,
    Network,
    graphs,
    last_come,
    losing,
    network,
    networks,
    path,
    random_cov,
    random_priors,
    ring,
    run,
    shuffled,
    with_links,
)


@given(networks(), st.floats(0, 0.9), SEEDS, SEEDS)
@settings(max_examples=60)
def test_any_order_of_arrival_gives_the_same_bits(net: Network, loss: float, fate: int, order: int):
    link = losing(fate, loss)
    first_come = run(net, link)
    for pick in (shuffled(order), last_come):
        outcome = run(net, link, pick)
        assert outcome.same_bits(first_come)
        assert [e.ages for e in outcome.estimates] == [e.ages for e in first_come.estimates]
        assert outcome.counted("missed") == first_come.counted("missed")


@given(networks(), st.floats(0, 0.9), SEEDS, SEEDS)
@settings(max_examples=40)
def test_what_a_link_loses_is_as_if_it_had_never_come(
    net: Network, loss: float, fate: int, order: int
):
    """Marked as lost on arrival, or dropped on the way until the time of a cycle is over."""
    links = LinkState((fate, order), loss, outages=(Outage(0, 1, 1, 3),))
    marked = with_links(net, links)

    def dropping(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        cycle = read_frame(frame).cycle
        arrives = hears(links, cycle // net.world.rounds, cycle, sender, receiver)
        return (frame,) if arrives else ()

    dropped = run(net, dropping)
    for pick in (first_come, shuffled(order), last_come):
        outcome = run(marked, pick=pick)
        assert outcome.same_bits(dropped)
        assert outcome.counted("missed") == dropped.counted("missed")
        assert outcome.counted("lost") == outcome.counted("missed")
        assert outcome.counted("late") == 0


@given(networks(), SEEDS)
@settings(max_examples=40)
def test_repeated_stale_and_broken_frames_change_nothing_but_counters(net: Network, order: int):
    generator = np.random.default_rng(order)
    before: dict[tuple[int, int], bytes] = {}
    planted = 0

    def pestering(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        nonlocal planted
        broken = bytearray(frame)
        bit = int(generator.integers(8 * len(frame)))
        broken[bit // 8] ^= 1 << bit % 8
        stale = before.get((sender, receiver), frame)
        before[sender, receiver] = frame
        planted += 5
        return (bytes(broken), b"", frame[:9], frame, frame, stale)

    clean = run(net)
    pestered = run(net, pestering, shuffled(order))
    assert pestered.same_bits(clean)
    assert pestered.counted("missed") == 0
    # Each planted frame adds one count; those that were under way at the end add none.
    counts = [sum(state.counters.values()) for state in (*pestered.states, *clean.states)]
    assert sum(counts[: len(net.nodes)]) <= sum(counts[len(net.nodes) :]) + planted


@given(graphs(least=2), st.integers(0, 2), SEEDS, st.floats(0, 1), SEEDS)
@pytest.mark.parametrize("name", sorted(HOLDS))
@pytest.mark.parametrize("average", [MOMENTS, INFORMATION])
@settings(max_examples=15)
def test_equal_beliefs_stay_equal_under_any_loss(
    average, name: str, adjacency: Adjacency, kind: int, seed: int, loss: float, fate: int
):
    count = len(adjacency)
    belief = random_priors(np.random.default_rng(seed), 1, 2)[0]
    schedule = (full_publish(count), round_robin(count, 1), hybrid(count, 0.5))[kind]
    net = network(
        adjacency,
        [belief] * count,
        steps=4,
        rounds=3,
        matrix=TURN,
        process_noise_cov=0.1 * np.eye(2),
        average=average,
        hold_policy=HOLDS[name],
        schedule=schedule,
    )
    outcome = run(net, losing(fate, loss), shuffled(fate))
    # The belief of one node alone, by the Kalman filter's equations.
    mean, cov = belief
    for step in range(4):
        if step:
            mean, cov = TURN @ mean, TURN @ cov @ TURN.T + 0.1 * np.eye(2)
        np.testing.assert_allclose(outcome.mean[step], [mean] * count, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(outcome.cov[step], [cov] * count, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("hold_policy", [PREDICT, DECAYED])
def test_agreeing_nodes_that_never_hear_each_other_miss_everything(hold_policy: HoldPolicy):
    belief = Gaussian(np.zeros(2), np.eye(2))
    net = network(path(3), [belief] * 3, steps=2, rounds=2, hold_policy=hold_policy)
    outcome = run(net, lambda sender, receiver, frame: ())
    # Four directed links, two steps of two cycles.
    assert outcome.counted("missed") == 16
    assert outcome.counted("heard") == 0
    assert all(age == -1 for estimate in outcome.estimates for age in estimate.ages)


def test_a_neighbour_may_run_far_ahead_without_loss():
    """Node 0 is served last: by then its neighbour has run as far ahead as turns allow."""
    count, rounds = 80, 60
    generator = np.random.default_rng(0)
    net = network(
        ring(count),
        random_priors(generator, count, 1),
        steps=2,
        rounds=rounds,
        schedule=round_robin(count, 1),
        hold_policy=PREDICT,
        process_noise_cov=random_cov(generator, 1),
    )
    newest_first = run(net, pick=last_come)
    assert newest_first.counted("missed") == 0
    assert newest_first.counted("rejected future") == 0
    assert newest_first.same_bits(run(net))
