"""Set-membership nodes: the truth stays inside at every node, whatever the network does."""

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.features.sets.set_membership import SetAtNode, SetMembership
from concord.features.sets.set_shapes import Ellipsoids, Zonotopes
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.changes import UNCHANGED
from concord.nodes.estimator import EarlierBelief
from concord.nodes.messages import Measured
from concord.nodes.rules.lane_rule import FIRST_BID, Place
from concord.nodes.vector_codec import VectorCodec
from concord.runtime import in_process
from concord.runtime.in_process import Link
from concord.scenarios.build import build_node
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from tests.experiments.support import scenario
from tests.nodes.changing import run

RULES = pytest.mark.parametrize("rule", ["ellipsoid", "zonotope"])


def network(**changes) -> Setup:
    return prepare(scenario("liu2021-network", **{"steps": 15, **changes}))


def radii(setup: Setup, link: Link = in_process.lossless) -> np.ndarray:
    """e' P^-1 e (steps, N) of a run."""
    trace = run(setup, link=link)
    errors = (trace.mean - trace.truth[:, None])[..., None]
    return (errors.mT @ np.linalg.solve(trace.cov, errors))[..., 0, 0]


def losing(seed: int, share: float) -> Link:
    """Frames get lost at random, and some come twice."""
    rng = np.random.default_rng(seed)

    def link(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        draw = rng.uniform()
        return () if draw < share else (frame, frame) if draw > 0.9 else (frame,)

    return link


@RULES
@settings(max_examples=8)
@given(
    seed=st.integers(0, 1000),
    share=st.sampled_from([0.0, 0.3, 0.9]),
    occupancy=st.sampled_from([0.2, 0.5, 1.0]),
    number=st.sampled_from(["float64", "float32"]),
)
def test_the_truth_stays_inside_at_every_node(
    rule: str, seed: int, share: float, occupancy: float, number: str
):
    schedule = "full" if occupancy == 1.0 else "hybrid"
    setup = network(
        rule=rule, seed=seed, schedule=schedule, occupancy=occupancy, number=number, nodes=4
    )
    assert (radii(setup, losing(seed, share)) <= 1).all()


@RULES
@pytest.mark.parametrize("hold", ["predict", "drop"])
def test_every_sound_hold_policy_keeps_it_inside(rule: str, hold: str):
    assert (radii(network(rule=rule, hold=hold, schedule="hybrid", occupancy=0.3)) <= 1).all()


@pytest.mark.slow
@RULES
def test_an_uncontrolled_plant_leaves_every_scale_but_no_set(rule: str):
    setup = network(rule=rule, control="open", steps=300, nodes=2, graph="path", rounds=1)
    assert (radii(setup) <= 1).all()


@pytest.mark.slow
@RULES
@pytest.mark.parametrize("gap", [0, 1, 6])
def test_a_node_that_begins_anew_from_an_older_set_holds_the_truth(rule: str, gap: int):
    """No node has said anything since. A node without an earlier set carries the prior."""
    for number in range(8):
        setup = network(
            rule=rule, control="open", noise="matched", nodes=2, graph="path", run=number
        )
        trace = run(setup)
        config = build_node(setup, 1)
        assert config.rebuild is not None
        began = 8 - gap
        belief = Gaussian(trace.mean[began - 1, 0], trace.cov[began - 1, 0])
        prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
        for earlier in (EarlierBelief(belief, began - 1), EarlierBelief(prior, 0), None):
            kept = config.rebuild(UNCHANGED, 8, earlier).estimator
            found = kept.belief(kept.start())
            error = trace.truth[7] - found.mean
            assert error @ np.linalg.solve(found.cov, error) <= 1
            # Without readings too.
            unread = Measured(1, 8, [[None] * trace.readings.shape[-1]])
            found = kept.belief(kept.begin_step(kept.start(), unread)[0])
            error = trace.truth[8] - found.mean
            assert error @ np.linalg.solve(found.cov, error) <= 1


def test_the_printed_noise_is_no_harder():
    assert (radii(network(noise="paper", control="open")) <= 1).all()


def test_a_network_knows_more_than_a_node():
    together, alone = network(), network(schedule="round-robin", occupancy=0.2, rounds=1)

    def size(setup: Setup, link: Link = in_process.lossless) -> float:
        return float(np.trace(run(setup, link=link).cov[-1].mean(0)))

    silent = size(alone, losing(0, 1.1))
    assert size(together) < size(alone) < silent


# --- one node ------------------------------------------------------------------------------------


class Still:
    """x' = x + 0.1 v."""

    def transition(self, state, control, step):
        return state

    def motion(self, step):
        return np.eye(2), 0.1 * np.eye(2)


class First:
    """The first state, within 0.1."""

    def bounded_rows(self, step):
        return np.array([[1.0, 0.0]]), np.zeros((1, 2)), np.array([0.1])


def one_node(shape, **changes) -> SetAtNode:
    prior = Gaussian(np.zeros(2), np.eye(2))
    length = len(shape.numbers_of(shape.containing(prior)))
    return SetAtNode(
        SetMembership(shape, **changes),
        Place(np.array(0), np.array([0.5, 0.5])),
        Still(),  # type: ignore[arg-type]
        First(),  # type: ignore[arg-type]
        prior,
        SigmaPointFilter(scaled_unscented(2)),
        VectorCodec(length),
    )


def told(shape, centre: list[float], variance: float) -> bytes:
    """The body of a share of a ball."""
    ball = shape.containing(Gaussian(np.array(centre), variance * np.eye(2)))
    return shape.numbers_of(ball).tobytes()


SHAPES = pytest.mark.parametrize("shape", [Ellipsoids(2), Zonotopes(2)])


def reading(step: int, value: float | None) -> Measured:
    return Measured(0, step, [[value]])


@SHAPES
def test_a_reading_that_contradicts_the_set_is_counted_and_left_out(shape):
    node = one_node(shape)
    start = node.start()
    content, failures = node.begin_step(start, reading(0, 3.0))
    assert failures == ("contradicting-reading",)
    assert node.belief(content).cov.tobytes() == node.belief(start).cov.tobytes()
    content, failures = node.begin_step(start, reading(0, 0.5))
    assert failures == ()
    assert node.belief(content).mean[0] == pytest.approx(0.5, abs=0.05)
    assert np.trace(node.belief(content).cov) < np.trace(node.belief(start).cov)
    content, failures = node.begin_step(start, reading(0, None))
    assert failures == ()
    assert node.belief(content).cov.tobytes() == node.belief(start).cov.tobytes()


@SHAPES
def test_a_share_that_contradicts_the_set_is_counted_and_not_held(shape):
    node = one_node(shape)
    content, _ = node.begin_step(node.start(), reading(0, 0.0))
    after, failures = node.fuse(content, (told(shape, [5.0, 5.0], 0.01),))
    assert failures == ("contradicting-share",)
    assert node.ages(after).tolist() == [-1]
    assert node.belief(after).cov.tobytes() == node.belief(content).cov.tobytes()


@SHAPES
def test_a_held_set_is_carried_with_the_plant_and_helps_later(shape):
    small = told(shape, [0.0, 0.0], 1e-4)
    sizes = {}
    for carried in (True, False):
        node = one_node(shape, carried=carried)
        # The second share is of the same step, and the third, silent, of the next.
        content, _ = node.begin_step(node.start(), reading(0, None))
        content, _ = node.fuse(content, (small,))
        assert node.ages(content).tolist() == [0]
        # Forget what was learned, as a node that restarts: only what is held is left.
        content = content._replace(own=node.start().own)
        content, _ = node.begin_step(content, reading(1, None))
        content, _ = node.fuse(content, (None,))
        assert node.ages(content).tolist() == [1]
        sizes[carried] = np.trace(node.belief(content).cov)
    assert sizes[True] < 0.1 * sizes[False]


def test_a_set_that_grew_by_rounding_alone_is_not_below_a_trigger_of_zero():
    """Drivers round differently, and must ask for the same slots."""
    rule = SetMembership(Ellipsoids(2), trigger=0.0)
    start = rule.start(np.array(0), *[Gaussian(np.zeros(2), np.eye(2))] * 2)
    content = rule.sent(start, np.array(True))
    kept = content.own.kept
    grown = kept._replace(factor=kept.factor * (1 + 1e-15))
    assert rule.bid(content._replace(own=content.own._replace(kept=grown))) == 0


@SHAPES
def test_a_bid_is_how_much_there_is_to_tell(shape):
    node = one_node(shape, trigger=0.5)
    content, _ = node.begin_step(node.start(), reading(0, None))
    assert node.bid(content) == FIRST_BID
    content, body = node.compose(content)
    assert len(body) == node.share_bytes
    assert node.bid(content) is None  # nothing new: below the trigger
    content, _ = node.fuse(content, (told(shape, [0.0, 0.0], 0.01),))
    urgent = node.bid(content)
    assert urgent is not None
    assert 0 < urgent < FIRST_BID


@SHAPES
@given(powers=st.tuples(st.integers(-20, 20), st.integers(-20, 20)), seed=st.integers(0, 99))
def test_a_bid_does_not_depend_on_the_units_of_the_states(shape, powers, seed: int):
    units, rng = 2.0 ** np.array(powers), np.random.default_rng(seed)
    bids = []
    factors = rng.standard_normal((2, 2, 2))
    for unit in (np.ones(2), units):
        rule = SetMembership(shape)
        prior, kept = (Gaussian(np.zeros(2), unit[:, None] * one @ one.T * unit) for one in factors)
        content = rule.sent(rule.start(np.array(0), prior, prior), np.array(True))
        own = content.own._replace(kept=shape.containing(kept))
        bids.append(int(rule.bid(content._replace(own=own))))
    assert bids[0] == bids[1]
