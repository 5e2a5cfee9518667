"""Test how a node uses its readings and shares, without the state machine around it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.filters.fusion.averaging import INFORMATION
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.messages import Measured
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.belief_consensus import BeliefConsensus, BeliefContent, HoldPolicy
from concord.nodes.rules.lane_rule import FIRST_BID, Place
from concord.nodes.rules.local_filter import at
from concord.nodes.vector_codec import BeliefCodec
from tests.nodes.networks import DECAYED, DROP, PREDICT, Linear, WholeState, random_priors
from tests.nodes.test_fresh_consensus import assert_close, kalman

SEEDS = st.integers(0, 2**32 - 1)
F = np.array([[1.0, 0.5], [0.0, 0.9]])
Q = np.array([[0.3, 0.1], [0.1, 0.2]])
R = 0.5 * np.eye(2)
PRIOR, LEFT, RIGHT = random_priors(np.random.default_rng(1), 3, 2)
BLIND: list[list[float | None]] = [[None, None]]


def estimator(hold: HoldPolicy = PREDICT, sees: bool = False, gate: float | None = None):
    return AtNode(
        BeliefConsensus(INFORMATION, hold, states=2),
        Place(np.array(0), np.array([0.4, 0.3, 0.3])),
        model=Linear(F, Q),
        sensor=WholeState(R, gate) if sees else None,
        prior=PRIOR,
        filter=SigmaPointFilter(scaled_unscented(2)),
        codec=BeliefCodec(2).vector,
    )


def told(belief: Gaussian | None) -> bytes | None:
    """The body of a share."""
    return None if belief is None else BeliefCodec(2).encode(belief)


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), max_size=3), st.integers(0, 1))
def test_a_step_is_predict_and_one_update_for_each_reading(readings: list, first: int):
    rule = estimator(sees=True)
    number = 1 - first
    content, failures = rule.begin_step(
        rule.start(), Measured(0, number, [list(reading) for reading in readings])
    )
    expected = PRIOR if first else Gaussian(F @ PRIOR.mean, F @ PRIOR.cov @ F.T + Q)
    for reading in readings:
        expected = kalman(expected, np.array(reading), R)
    assert_close(rule.belief(content), expected)
    assert failures == ()


def test_a_reading_beyond_the_gate_is_refused_and_named():
    rule = estimator(sees=True, gate=9.0)
    content, failures = rule.begin_step(rule.start(), Measured(0, 0, [[1e3, 0.0]]))
    assert failures == ("gated",)
    assert_close(rule.belief(content), PRIOR)


@pytest.mark.parametrize("hold", [PREDICT, DECAYED, DROP])
def test_ages_count_the_cycles_since_a_share_was_sent(hold: HoldPolicy):
    rule = estimator(hold)
    content = rule.start()
    heard = {0: (None, None), 1: (LEFT, None), 2: (None, None), 3: (None, RIGHT), 4: (LEFT, None)}
    expected = {0: [-1, -1], 1: [0, -1], 2: [1, -1], 3: [2, 0], 4: [0, 1]}
    for cycle, shares in heard.items():
        content, _ = rule.fuse(content, tuple(map(told, shares)))
        assert rule.ages(content).tolist() == expected[cycle]
    # A step of the plant is no cycle of the bus.
    content, _ = rule.begin_step(content, Measured(0, 1, BLIND))
    assert rule.ages(content).tolist() == [0, 1]


def test_who_was_never_heard_has_no_weight():
    rule = estimator(PREDICT)
    content, _ = rule.fuse(rule.start(), (None, None))
    assert_close(rule.belief(content), PRIOR)


@pytest.mark.parametrize(("hold", "carried"), [(PREDICT, True), (DROP, False)])
def test_a_held_pair_is_carried_through_the_plant_if_the_policy_says_so(
    hold: HoldPolicy, carried: bool
):
    rule = estimator(hold)
    content, _ = rule.fuse(rule.start(), (told(LEFT), None))
    content, _ = rule.begin_step(content, Measured(0, 1, BLIND))
    kept = at(content.held.beliefs, 0)
    assert_close(kept, Gaussian(F @ LEFT.mean, F @ LEFT.cov @ F.T + Q) if carried else LEFT)


def test_a_share_that_is_no_covariance_is_dropped_and_named():
    rule = estimator(PREDICT)
    broken = Gaussian(LEFT.mean, np.array([[1.0, 2.0], [2.0, 1.0]]))
    content, failures = rule.fuse(rule.start(), (told(broken), told(RIGHT)))
    assert failures == ("rejected not-positive-definite",)
    alone, _ = rule.fuse(rule.start(), (None, told(RIGHT)))
    assert_close(rule.belief(content), rule.belief(alone))
    assert rule.ages(content).tolist() == [-1, 0]


# --- bids ----------------------------------------------------------------------------------------


def believing(content: BeliefContent, belief: Gaussian) -> BeliefContent:
    return content._replace(own=content.own._replace(belief=belief))


def moved_by(rule: AtNode, change: np.ndarray):
    """A content that has published its prior and then moved on by `change`."""
    content, _ = rule.compose(rule.start())
    return believing(content, Gaussian(PRIOR.mean + change, PRIOR.cov))


def test_who_has_never_published_bids_highest():
    rule = estimator()
    assert rule.bid(rule.start()) == FIRST_BID
    far = moved_by(rule, np.array([1e9, 1e9]))
    assert FIRST_BID > (rule.bid(far) or 0) > 0


@given(st.floats(-50, 50), st.floats(-50, 50))
def test_a_bid_is_the_squared_change_in_units_of_the_covariance(a: float, b: float):
    rule = estimator()
    change = np.array([a, b])
    squared = float(change @ np.linalg.inv(PRIOR.cov) @ change)
    bid = rule.bid(moved_by(rule, change))
    assert isinstance(bid, int)
    assert bid == pytest.approx(1024 * squared, abs=1 + 1e-9 * squared)


def test_below_its_trigger_a_node_asks_for_nothing():
    plain = estimator()
    assert isinstance(plain.rule, BeliefConsensus)
    rule = replace(plain, rule=replace(plain.rule, trigger=4.0))
    step = np.linalg.cholesky(PRIOR.cov) @ np.array([1.0, 0.0])
    assert rule.bid(moved_by(rule, 1.9 * step)) is None
    assert rule.bid(moved_by(rule, 2.1 * step)) == pytest.approx(1024 * 4.41, abs=1)
    assert rule.bid(rule.start()) == FIRST_BID


def test_what_was_published_is_carried_on_too():
    """A belief that only follows the plant model is no news."""
    rule = estimator(PREDICT)
    content, _ = rule.compose(rule.start())
    content, _ = rule.begin_step(content, Measured(0, 1, BLIND))
    assert rule.bid(content) == 0


@given(SEEDS)
def test_what_is_composed_is_what_is_accepted(seed: int):
    (belief,) = random_priors(np.random.default_rng(seed), 1, 2)
    rule = estimator()
    content, body = rule.compose(believing(rule.start(), belief))
    assert len(body) == rule.share_bytes
    accepted = BeliefCodec(2).decode(rule.accept(body))
    np.testing.assert_array_equal(accepted.mean, belief.mean)
    np.testing.assert_array_equal(accepted.cov, (belief.cov + belief.cov.T) / 2)
    assert content.own.published.known
    np.testing.assert_array_equal(content.own.published.belief.mean, belief.mean)
    np.testing.assert_array_equal(content.own.published.belief.cov, belief.cov)
