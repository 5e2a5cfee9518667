"""The rule `labelled`: every node holds what could reach it, and uses each record once."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import cycle_of
from concord.bus.schedule import Schedule, dynamic_only, full_publish, hybrid, round_robin
from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import Rejected
from concord.nodes.faults.losses import LinkState
from concord.nodes.messages import Measured
from concord.nodes.rules.labelled.flooding import LabelledFlooding
from concord.nodes.rules.labelled.frame import LabelledShare
from concord.nodes.rules.labelled.record_codec import RecordCodec
from tests.nodes.labelled_networks import (
    PRIOR,
    carried,
    fate,
    held_by,
    kalman,
    labelled,
    lone,
    reachable,
    taken,
)
from tests.nodes.networks import (
    Network,
    graphs,
    last_come,
    path,
    ring,
    run,
    shuffled,
    with_links,
)

SEEDS = st.integers(0, 2**32 - 1)
ALWAYS = lambda sender, receiver, cycle: True  # noqa: E731


def schedules(count: int) -> st.SearchStrategy[Schedule]:
    """Every kind, with and without relaying."""
    occupancy = st.sampled_from([0.2, 0.4, 0.7, 1.0])
    plain = st.one_of(
        st.just(full_publish(count)),
        st.integers(1, count).map(lambda slots: round_robin(count, slots)),
        occupancy.map(lambda part: hybrid(count, part)),
        occupancy.map(lambda part: dynamic_only(count, part)),
    )
    return st.tuples(plain, st.booleans()).map(
        lambda chosen: Schedule(
            chosen[0].nodes,
            chosen[0].static_table,
            chosen[0].contender_table,
            chosen[0].dynamic_slot_table,
            relay=chosen[1],
        )
    )


@st.composite
def networks(
    draw: st.DrawFn, least_window: int = 2, most_steps: int = 9, digest: bool = False
) -> Network:
    """Networks of a few nodes; steps go beyond the window."""
    adjacency = draw(graphs(least=2, most=5))
    count = len(adjacency)
    window_steps = draw(st.integers(least_window, 4))
    return labelled(
        adjacency,
        steps=draw(st.integers(1, most_steps)),
        rounds=draw(st.integers(1, 3)),
        seeing=draw(st.lists(st.sampled_from(range(count)), unique=True, min_size=1)),
        schedule=draw(schedules(count)),
        window_steps=window_steps,
        digest_steps=window_steps if digest else 0,
        # Room for all that a window can hold: what is left over for later is tested by itself.
        limit_bytes=2 + 5 + 20 + 20 * 18,
        seed=draw(st.integers(0, 99)),
    )


# --- exactness -----------------------------------------------------------------------------------


@pytest.mark.parametrize("relay", [False, True])
def test_with_all_records_in_time_every_node_is_the_centralised_filter(relay: bool):
    schedule = full_publish(4)
    schedule = Schedule(4, schedule.static_table, relay=relay)
    # On a path of four a record needs three rounds to be everywhere.
    net = labelled(path(4), steps=20, rounds=3, seeing=[0, 1, 3], schedule=schedule)
    outcome = run(net)
    central = kalman(net, taken(outcome), taken(outcome))
    for node in range(4):
        np.testing.assert_allclose(outcome.mean[-1, node], central.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(outcome.cov[-1, node], central.cov, rtol=0, atol=1e-9)


@given(graphs(least=2, most=5), SEEDS)
@settings(max_examples=10)
def test_nodes_that_hold_the_same_agree_bit_for_bit(adjacency, seed: int):
    """Whatever the order in which it came to them: rounds enough for all to be everywhere."""
    count = len(adjacency)
    net = labelled(
        adjacency, steps=4, rounds=count, seeing=range(count), schedule=full_publish(count),
        limit_bytes=2000, seed=seed % 100,
    )  # fmt: skip
    outcome = run(net)
    for node in range(count):
        assert outcome.mean[:, node].tobytes() == outcome.mean[:, 0].tobytes()
        assert outcome.cov[:, node].tobytes() == outcome.cov[:, 0].tobytes()


@given(graphs(least=2, most=5), SEEDS)
@settings(max_examples=4)
def test_once_all_records_came_the_base_is_the_centralised_posterior(adjacency, seed: int):
    """One slot a cycle: records come late, and are all there when their step leaves the window."""
    count = len(adjacency)
    net = labelled(
        adjacency, steps=26, rounds=2, seeing=range(count), schedule=round_robin(count, 1),
        window_steps=16, limit_bytes=2000, seed=seed % 100,
    )  # fmt: skip
    outcome = run(net)
    readings = taken(outcome)
    base_step = outcome.states[0].content.windows.step_at(0) - 1
    assert base_step == 25 - 16
    shorter = net._replace(environment=replace(net.environment, steps=base_step + 1))
    expected = kalman(shorter, readings, [label for label in readings if label[0] <= base_step])
    for state in outcome.states:
        base = state.content.windows.base
        np.testing.assert_allclose(base.mean[0, 0], expected.mean, atol=1e-9)
        np.testing.assert_allclose(base.cov[0, 0], expected.cov, atol=1e-9)


# --- who holds what ------------------------------------------------------------------------------


@given(networks())
@settings(max_examples=20)
def test_without_loss_a_node_holds_exactly_what_could_reach_it(net: Network):
    outcome = run(net)
    assert held_by(outcome.states) == reachable(net, outcome, ALWAYS)[-1]


@given(networks(digest=True), SEEDS, st.floats(0, 0.7))
@settings(max_examples=20)
def test_with_loss_a_node_holds_exactly_what_could_reach_it(net: Network, seed: int, loss: float):
    """With digests of the whole window; the frames that came say the same."""
    link, arrives = fate(seed, loss)
    outcome = run(net, link)
    held = held_by(outcome.states)
    assert held == carried(net, outcome, arrives)[-1]
    assert held == reachable(net, outcome, arrives)[-1]


@given(networks(digest=True), SEEDS)
@settings(max_examples=12)
def test_on_a_graph_that_changes_a_node_holds_exactly_what_could_reach_it(net: Network, seed: int):
    """Every link is there in some steps and not in others, in one direction or both."""

    def up(step, sender, receiver):
        return (seed >> (step + 3 * sender + 5 * receiver) % 32) & 1 == 1

    rounds = net.nodes[0].rounds
    outcome = run(with_links(net, LinkState(link_up=up)))
    expected = reachable(net, outcome, lambda s, r, cycle: up(cycle // rounds, s, r))
    assert held_by(outcome.states) == expected[-1]


@pytest.mark.parametrize("repeat_above", [0.0, 0.12, 10.0])
def test_a_digest_brings_back_what_was_lost(repeat_above: float):
    """Every frame of the first step is lost; with a digest the records are there a step later."""
    nets = [
        labelled(
            ring(4), steps=4, rounds=2, seeing=range(4), schedule=full_publish(4),
            digest_steps=digest, limit_bytes=600, repeat_above=repeat_above,
        )
        for digest in (0, 4)
    ]  # fmt: skip
    missing = []
    for net in nets:
        outcome = run(net, lambda s, r, frame: () if cycle_of(frame) < 2 else (frame,))
        missing.append(
            sum((0, j) not in some for some in held_by(outcome.states) for j in range(4))
        )
    assert missing == [12, 0]


# --- each once -----------------------------------------------------------------------------------


@given(networks(least_window=4, most_steps=4), SEEDS, st.floats(0, 0.6))
@settings(max_examples=20)
def test_the_estimate_is_that_of_the_records_held_each_counted_once(
    net: Network, seed: int, loss: float
):
    """As long as no step has left the window: frames come twice, and in any order."""
    link, _ = fate(seed, loss)
    outcome = run(net, lambda s, r, frame: 2 * tuple(link(s, r, frame)), shuffled(seed))
    readings = taken(outcome)
    for node, labels in enumerate(held_by(outcome.states)):
        expected = kalman(net, readings, labels)
        np.testing.assert_allclose(outcome.mean[-1, node], expected.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(outcome.cov[-1, node], expected.cov, rtol=0, atol=1e-9)


@given(networks(digest=True), SEEDS, st.floats(0, 0.6))
@settings(max_examples=15)
def test_nobody_ever_knows_more_than_the_centralised_filter(net: Network, seed: int, loss: float):
    """Windows pass and checkpoints are fused: a record counted twice would show."""
    link, _ = fate(seed, loss)
    outcome = run(net, link)
    readings = taken(outcome)
    for step in range(net.environment.steps):
        until = net._replace(environment=replace(net.environment, steps=step + 1))
        best = kalman(until, readings, [label for label in readings if label[0] <= step])
        for node in range(len(net.nodes)):
            margin = np.linalg.eigvalsh(outcome.cov[step, node] - best.cov)
            assert margin.min() > -1e-6 * np.trace(best.cov)


@given(networks(digest=True), SEEDS, st.floats(0, 0.6))
@settings(max_examples=8)
def test_any_order_of_arrival_gives_the_same_bits(net: Network, seed: int, loss: float):
    link, _ = fate(seed, loss)
    first = run(net, link)
    assert run(net, link, shuffled(seed)).same_bits(first)
    assert run(net, link, last_come).same_bits(first)


# --- bids and composition ------------------------------------------------------------------------


def test_a_bid_counts_the_lacking_neighbours_and_discounts_by_age():
    estimator = lone([1])
    content, _ = estimator.begin_step(estimator.start(), Measured(1, 0, [[1.0, 2.0]]))
    waited = 1
    assert estimator.bid(content) == 2 * 65536 * 4096 + waited
    content, _ = estimator.fuse(content, (None, None))
    content, _ = estimator.begin_step(content, Measured(1, 1, [[None, None]]))
    # Two neighbours lack a record of one step ago: 0.9 of the urgency each, rounded.
    assert estimator.bid(content) == 2 * 58982 * 4096 + waited + 1
    content, body = estimator.compose(content)
    assert len(body) == 2 + 2 + 16
    content, _ = estimator.fuse(content, (None, None))
    assert estimator.bid(content) is None


def test_newest_records_go_first_and_the_rest_waits():
    estimator = lone([1], limit_bytes=2 + 2 * 18 + 5)
    content = estimator.start()
    for step in range(3):
        content, _ = estimator.begin_step(content, Measured(1, step, [[float(step), 0.0]]))
        content, _ = estimator.fuse(content, (None, None))
    content, body = estimator.compose(content)
    assert [r.age for r in estimator.accept(body).records] == [1 - 1, 1]
    content, _ = estimator.fuse(content, (None, None))
    _, body = estimator.compose(content)
    assert [r.age for r in estimator.accept(body).records] == [2]


def test_a_neighbour_that_never_got_a_step_is_owed_its_checkpoint():
    estimator = lone([1], window_steps=2)
    content = estimator.start()
    for step in range(3):
        assert not content.owed
        content, _ = estimator.begin_step(content, Measured(1, step, [[0.5, 0.5]]))
        content, _ = estimator.fuse(content, (None, None))
    assert content.owed
    content, body = estimator.compose(content)
    checkpoint = estimator.accept(body).checkpoint
    assert checkpoint is not None and not content.owed
    np.testing.assert_allclose(checkpoint.cov, content.windows.base.cov[0, 0], rtol=1e-6)


def test_a_checkpoint_that_is_no_covariance_is_refused():
    estimator = lone([1])
    bad = LabelledShare(False, Gaussian(np.zeros(2), -np.eye(2)), (), ())
    with pytest.raises(Rejected, match="not-positive-definite"):
        estimator.accept(estimator.frames.encode(bad))


def test_records_of_steps_in_the_base_are_late():
    estimator = lone([0, 1], window_steps=4)
    content = estimator.start()
    for step in range(3):
        content, _ = estimator.begin_step(content, Measured(1, step, [[None, None]]))
        content, _ = estimator.fuse(content, (None, None))
    old = estimator.frames.decode(bytes((0, 1, 0, 3)) + np.zeros(2).tobytes())
    after, failures = estimator.fuse(content, (old, None))
    assert failures == ("record-late",)
    assert estimator.belief(after).cov.tobytes() == estimator.belief(content).cov.tobytes()


# --- restart --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Restarting:
    """A node that loses everything at a step: another estimator around its own."""

    inner: LabelledFlooding
    at_step: int
    prior: Gaussian

    def begin_step(self, content, measured: Measured):
        if measured.step == self.at_step:
            content = self.inner.restart(self.prior, content)
        return self.inner.begin_step(content, measured)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


@pytest.mark.parametrize("at_step", [2, 9])
def test_a_restarted_node_knows_nothing_until_a_checkpoint_and_then_what_the_others_know(
    at_step: int,
):
    """Before and after the first step leaves the window of six."""
    net = labelled(
        ring(4), steps=20, rounds=2, seeing=range(4), schedule=full_publish(4), window_steps=6,
        limit_bytes=600,
    )  # fmt: skip
    wide = Gaussian(np.array([50.0, 50.0]), 1e4 * np.eye(2))
    nodes = [*net.nodes]
    inner: Any = nodes[2].estimator
    nodes[2] = replace(nodes[2], estimator=Restarting(inner, at_step, wide))
    rounds = net.nodes[0].rounds

    def dead(sender, receiver, frame):
        # In the step of its restart, frames reach the node in the first cycle only.
        return () if receiver == 2 and cycle_of(frame) == at_step * rounds + 1 else (frame,)

    outcome = run(net._replace(nodes=nodes))
    untouched = run(net)
    # In the step of the restart the neighbours hear its call first, and answer a cycle later.
    assert not np.isnan(outcome.mean).any()
    np.testing.assert_allclose(
        outcome.cov[at_step + 1 :, 2], untouched.cov[at_step + 1 :, 2], rtol=1e-5
    )
    lost = run(net._replace(nodes=nodes), dead)
    assert np.isnan(lost.mean[at_step, 2]).all() and np.isnan(lost.cov[at_step, 2]).all()
    assert np.isnan(lost.mean).any(axis=(1, 2)).sum() == 1
    others = [0, 1, 3]
    np.testing.assert_allclose(lost.cov[-1, others], untouched.cov[-1, others], rtol=1e-5)


def test_start_is_the_common_prior():
    estimator = lone([1])
    np.testing.assert_array_equal(estimator.belief(estimator.start()).mean, PRIOR.mean)
    np.testing.assert_array_equal(estimator.belief(estimator.start()).cov, PRIOR.cov)
    assert estimator.ages(estimator.start()).tolist() == [-1, -1]


def test_a_reading_that_follows_as_float64_is_counted():
    estimator = lone([1])
    codecs = [None, RecordCodec(1, 2, "<i2", np.full(2, 1e-3)), None]
    estimator = replace(estimator, filter=replace(estimator.filter, codecs=codecs))
    _, failures = estimator.begin_step(estimator.start(), Measured(1, 0, [[1.0, 40.0]]))
    assert failures == ("record-range",)
    _, failures = estimator.begin_step(estimator.start(), Measured(1, 0, [[1.0, 30.0]]))
    assert failures == ()
