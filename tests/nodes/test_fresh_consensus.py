"""Test how a rule without held shares uses readings and shares, sound and unsound."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import Rejected
from concord.nodes.messages import CycleClosed, Estimate, Measured, NodeEvent, ShareHeard
from concord.nodes.node import NodeConfig, Phase, initial_state, step
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.fresh_consensus import FreshConsensus
from tests.nodes.networks import Linear, WholeState, path, random_priors
from tests.nodes.rule_networks import FRESH, F, Q, noise_cov, ruled

PRIORS = random_priors(np.random.default_rng(5), 3, 2)
BLIND: list[list[float | None]] = [[None, None]]
READING: list[list[float | None]] = [[0.4, -1.2]]
EACH = pytest.mark.parametrize("rule", FRESH)


def middle(rule: str, rounds: int = 2) -> NodeConfig:
    """Node 1 of the path 0 - 1 - 2, all of which see."""
    return ruled(rule, path(3), PRIORS, steps=3, rounds=rounds, seeing=[0, 1, 2]).nodes[1]


def estimator(rule: str) -> AtNode:
    found = middle(rule).estimator
    assert isinstance(found, AtNode) and isinstance(found.rule, FreshConsensus)
    return found


def neighbours_share(rule: str) -> bytes:
    """Return the share of node 0 after its reading."""
    left = ruled(rule, path(3), PRIORS, steps=3, rounds=2, seeing=[0, 1, 2]).nodes[0].estimator
    content, _ = left.begin_step(left.start(), Measured(0, 0, READING))
    return left.accept(left.compose(content)[1])


def kalman(belief: Gaussian, value: np.ndarray, noise: np.ndarray) -> Gaussian:
    gain = belief.cov @ np.linalg.inv(belief.cov + noise)
    return Gaussian(belief.mean + gain @ (value - belief.mean), (np.eye(2) - gain) @ belief.cov)


def assert_close(belief: Gaussian, expected: Gaussian) -> None:
    np.testing.assert_allclose(belief.mean, expected.mean, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(belief.cov, expected.cov, rtol=1e-11, atol=1e-12)


@EACH
def test_a_step_is_predict_and_one_update_for_each_reading(rule: str):
    node = estimator(rule)
    content, failures = node.begin_step(
        node.start(), Measured(1, 1, [[0.4, -1.2], [2.0, 0.1]], [1.0, -2.0])
    )
    prior = Gaussian(F @ PRIORS[1].mean + [1.0, -2.0], F @ PRIORS[1].cov @ F.T + Q)
    assert_close(content.own.prior, prior)
    once = kalman(prior, np.array([0.4, -1.2]), noise_cov(1))
    assert_close(node.belief(content), kalman(once, np.array([2.0, 0.1]), noise_cov(1)))
    assert failures == ()


@EACH
def test_what_fails_is_named_and_leaves_the_belief(rule: str):
    lost = replace(estimator(rule), model=Linear(np.full((2, 2), np.nan), Q))
    content, failures = lost.begin_step(lost.start(), Measured(1, 1, BLIND))
    assert failures == ("predict-failed",)
    assert_close(lost.belief(content), PRIORS[1])
    misled = replace(estimator(rule), sensor=WholeState(-20 * noise_cov(1)))
    content, failures = misled.begin_step(misled.start(), Measured(1, 0, READING))
    assert failures == ("update-failed",)
    assert_close(misled.belief(content), PRIORS[1])


@EACH
def test_what_is_composed_is_what_is_accepted(rule: str):
    node = estimator(rule)
    content, _ = node.begin_step(node.start(), Measured(1, 0, READING))
    for _ in range(2):
        content, body = node.compose(content)
        assert len(body) == node.share_bytes
        said = node.accept(body + b"padding of a static slot")
        assert said == body
        content, _ = node.fuse(content, (None, None))


@EACH
def test_bodies_that_no_sound_peer_sends_are_rejected(rule: str):
    node = estimator(rule)
    _, body = node.compose(node.start())
    with pytest.raises(Rejected, match="share-length"):
        node.accept(body[:-1])
    for bad in (np.nan, np.inf):
        numbers = np.frombuffer(body).copy()
        numbers[-1] = bad
        with pytest.raises(Rejected, match="share-not-finite"):
            node.accept(numbers.tobytes())


@EACH
def test_a_share_that_is_no_information_is_dropped_and_counted(rule: str):
    node = estimator(rule)
    content, _ = node.begin_step(node.start(), Measured(1, 0, READING))
    sound = neighbours_share(rule)
    broken = np.frombuffer(sound).copy()
    broken[2] = -1e3  # the first entry of the first matrix
    fused, failures = node.fuse(content, (broken.tobytes(), sound))
    assert failures == ("rejected unsound",)
    assert node.ages(fused).tolist() == [-1, 0]
    without, _ = node.fuse(content, (None, sound))
    np.testing.assert_array_equal(node.belief(fused).mean, node.belief(without).mean)
    np.testing.assert_array_equal(node.belief(fused).cov, node.belief(without).cov)


@EACH
def test_ages_count_the_cycles_since_a_share_was_used(rule: str):
    node = estimator(rule)
    content, share = node.start(), neighbours_share(rule)
    for shares, expected in (
        ((None, None), [-1, -1]),
        ((share, None), [0, -1]),
        ((None, None), [1, -1]),
        ((None, share), [2, 0]),
    ):
        content, _ = node.fuse(content, shares)
        assert node.ages(content).tolist() == expected
    content, _ = node.begin_step(content, Measured(1, 1, BLIND))
    assert node.ages(content).tolist() == [2, 0]


@EACH
def test_nothing_heard_in_one_step_is_used_in_the_next(rule: str):
    node = estimator(rule)
    content, _ = node.fuse(node.start(), (neighbours_share(rule), None))
    before = node.belief(content)
    content, _ = node.begin_step(content, Measured(1, 1, BLIND))
    content, _ = node.fuse(content, (None, None))
    assert_close(node.belief(content), Gaussian(F @ before.mean, F @ before.cov @ F.T + Q))


# --- bids ----------------------------------------------------------------------------------------


@EACH
def test_a_bid_is_the_news_since_the_last_publication(rule: str):
    node = estimator(rule)
    content, _ = node.begin_step(node.start(), Measured(1, 0, BLIND))
    first = node.bid(content)
    content, _ = node.compose(content)
    # A belief that only follows the plant is no news; a reading is.
    content, _ = node.begin_step(content, Measured(1, 1, BLIND))
    assert node.bid(content) == 0
    assert isinstance(node.rule, FreshConsensus)
    silent = replace(node, rule=replace(node.rule, trigger=1e-6))
    assert silent.bid(content) is None
    content, _ = node.begin_step(content, Measured(1, 2, [[9.0, 9.0]]))
    news = silent.bid(content)
    assert news is not None
    assert first is not None
    assert 0 < news < first


# --- a peer that has lost its mind ---------------------------------------------------------------

ABSURD = [-1.7e308, -1.0, 1e-200, 1e8, 1.7e308]


@EACH
def test_absurd_numbers_with_right_checksums_stop_nobody(rule: str):
    config = middle(rule)
    node = config.estimator
    sound = np.frombuffer(neighbours_share(rule))
    n = len(sound)
    for first, diagonal, last in product(ABSURD, ABSURD, ABSURD):
        numbers = sound.copy()
        numbers[0], numbers[2], numbers[4], numbers[n - 1] = first, diagonal, diagonal, last
        state = initial_state(config)
        sent = []
        with np.errstate(all="ignore"):
            for number in range(config.steps):
                events: list[NodeEvent] = [Measured(1, number, READING)]
                for cycle in range(2 * number, 2 * number + 2):
                    frames = config.bus.encode(0, cycle, numbers.tobytes())
                    events += [ShareHeard(0, frame) for frame in frames]
                    events.append(CycleClosed(cycle))
                for event in events:
                    state, messages = step(config, state, event)
                    sent += messages
        assert state.phase is Phase.FINISHED
        estimates = [message for message in sent if isinstance(message, Estimate)]
        assert len(estimates) == config.steps
        assert all(None not in estimate.mean + estimate.cov for estimate in estimates)
        assert_covariance(node.belief(state.content).cov)


def assert_covariance(cov: np.ndarray) -> None:
    """The variances are positive, and no eigenvalue of the correlations is below rounding."""
    deviations = np.sqrt(np.diag(cov))
    assert (deviations > 0).all()
    correlations = cov / deviations[:, None] / deviations
    assert np.linalg.eigvalsh(correlations).min() >= -4 * np.finfo(float).eps
