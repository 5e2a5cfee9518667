"""A node that learns the noise of its own sensors, around any rule."""

import numpy as np
import pytest

from concord.filters.gaussian import Gaussian
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.messages import Measured, to_wire
from concord.nodes.rules.adaptive_noise import AdaptiveNoise, Learnt, declared_noise, learn
from concord.plants.oscillator import Oscillation, ScalarSensor
from concord.scenarios.catalogue import definition_named
from concord.scenarios.node_context import NodeContext, RuleContext
from concord.scenarios.rules import build_estimator, hold_policy
from concord.scenarios.scenario import Scenario

MODEL = Oscillation()
SENSOR = ScalarSensor(np.array([1.0, 0.0]), np.array(0.5))
POINTS = scaled_unscented(2)
PRIOR = Gaussian(np.zeros(2), np.eye(2))
RULES = ("ci", "wac", "local", "hcmci", "icf", "diffusion", "kcf")


def node_context() -> tuple[Scenario, NodeContext]:
    scenario = definition_named("oscillator").defaults.with_(nodes=2, graph="path", steps=1)
    return scenario, NodeContext(
        node=0,
        rule=RuleContext(len(PRIOR.mean), [[1], [0]], hold_policy(scenario), 0.0, "<f8"),
        weights=np.array([0.5, 0.5]),
        model=MODEL,
        sensor=SENSOR,
        prior=PRIOR,
        filter=SigmaPointFilter(POINTS),
        everybody=lambda: pytest.fail("these rules know nothing of all nodes"),
    )


def around(rule: str) -> AdaptiveNoise:
    scenario, place = node_context()
    inner = build_estimator(scenario.with_(rule=rule), place)
    return AdaptiveNoise(inner, SENSOR, POINTS)


def readings(noise_std: float, steps: int) -> list[list[float | None]]:
    """One channel of an oscillator, `noise_std` times as noisy as the sensor says."""
    generator = np.random.default_rng(3)
    state, taken = np.array([1.0, 0.0]), []
    factor = np.linalg.cholesky(MODEL.process_noise_cov(0))
    for _ in range(steps):
        state = MODEL.transition(state, None, 0) + factor @ generator.standard_normal(2)
        taken.append([float(state[0] + 0.5 * noise_std * generator.standard_normal())])
    return taken


def learnt(content: Learnt) -> np.ndarray:
    """The variances (m,)."""
    assert content.noise is not None
    return content.noise.variances


def run(estimator, taken):
    content, failures = estimator.start(), ()
    for step, reading in enumerate(taken):
        content, more = estimator.begin_step(content, Measured(0, step, [reading]))
        content, _ = estimator.compose(content)
        content, fused = estimator.fuse(content, (None,))
        failures += (*more, *fused)
    return content, failures


@pytest.mark.parametrize("rule", RULES)
def test_it_learns_that_a_sensor_has_become_noisy(rule):
    content, failures = run(around(rule), readings(3.0, 400))
    assert failures == ()
    # The average spans fifty readings: its deviation is a fifth of it.
    assert np.sqrt(learnt(content)[0]) == pytest.approx(1.5, rel=0.35)


def test_it_never_believes_less_noise_than_the_data_sheet():
    content, _ = run(around("ci"), readings(0.01, 100))
    assert learnt(content)[0] == 0.25


@pytest.mark.parametrize("rule", RULES)
def test_without_anything_to_learn_it_is_the_rule_itself(rule):
    """Exactly so in the first step, which takes the reading with the noise of the data sheet."""
    scenario, place = node_context()
    plain = build_estimator(scenario.with_(rule=rule), place)
    wrapped = around(rule)
    measured = Measured(0, 0, [[0.3]])
    ours, _ = wrapped.begin_step(wrapped.start(), measured)
    theirs, _ = plain.begin_step(plain.start(), measured)
    np.testing.assert_array_equal(wrapped.belief(ours).mean, plain.belief(theirs).mean)
    np.testing.assert_array_equal(wrapped.belief(ours).cov, plain.belief(theirs).cov)
    np.testing.assert_array_equal(wrapped.ages(ours), plain.ages(theirs))
    assert wrapped.share_bytes == plain.share_bytes == len(wrapped.compose(ours)[1])
    assert wrapped.bid(ours) == plain.bid(theirs)
    assert wrapped.compose(ours)[1] == plain.compose(theirs)[1]


def test_a_learnt_noise_is_what_the_next_reading_is_taken_with():
    wrapped = around("local")
    content, _ = run(wrapped, readings(8.0, 60))
    _, place = node_context()
    loud = ScalarSensor(SENSOR.row, np.sqrt(learnt(content)[0]))
    scenario, _ = node_context()
    plain = build_estimator(
        scenario.with_(rule="local"),
        place._replace(sensor=loud, prior=wrapped.belief(content)),
    )
    measured = Measured(0, 1, [[2.0]])
    after, _ = wrapped.begin_step(content, measured)
    expected, _ = plain.begin_step(plain.start(), measured)
    np.testing.assert_allclose(wrapped.belief(after).mean, plain.belief(expected).mean, rtol=1e-12)


def test_no_reading_teaches_nothing():
    content, _ = run(around("ci"), [[None], [None]])
    assert content.noise is None
    first, _ = run(around("ci"), [[0.3]])
    then, _ = run(around("ci"), [[0.3], [None], [None]])
    np.testing.assert_array_equal(learnt(first), learnt(then))


def test_learning_takes_readings_apart():
    """Channels are learnt one by one: what one lacks, the other does not feel."""
    both = ScalarSensor(np.array([1.0, 0.0]), np.array(0.5))
    noise = declared_noise(both, np.array([0.1]))
    np.testing.assert_array_equal(noise.variances, [0.25])
    assert learn(noise, PRIOR, np.array([9.0]), both, POINTS, 0).variances[0] > 1.0
    assert to_wire(noise.variances) == [0.25]
