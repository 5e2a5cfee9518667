"""Nodes whose filter learns the noise of their own sensors, under every rule with a filter."""

import numpy as np
import pytest

from concord.features.vehicle.options import AdaptiveUnscented, FuzzyUnscented
from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.lanes.filter import forgotten
from concord.nodes.messages import Measured
from concord.nodes.rules.local_filter import LocalFilters, SensorGroup
from concord.plants.oscillator import Oscillation, ScalarSensor
from concord.scenarios.catalogue import definition_named
from concord.scenarios.filter_table.filters import build_filter
from concord.scenarios.node_context import NodeContext, RuleContext
from concord.scenarios.rule_table.rules import build_estimator, hold_policy

MODEL = Oscillation()
SENSOR = ScalarSensor(np.array([1.0, 0.0]), np.array(0.5))
PRIOR = Gaussian(np.zeros(2), np.eye(2))
RULES = ("ci", "wac", "local", "hcmci", "icf", "diffusion", "kcf")
LEARNING = build_filter(AdaptiveUnscented(), 2)


def estimator_of(rule: str, filter: Filter):
    scenario = definition_named("oscillator").defaults.with_(nodes=2, graph="path", steps=1)
    place = NodeContext(
        node=0,
        rule=RuleContext(len(PRIOR.mean), [[1], [0]], hold_policy(scenario), 0.0, "<f8"),
        weights=np.array([0.5, 0.5]),
        model=MODEL,
        sensor=SENSOR,
        prior=PRIOR,
        filter=filter,
        everybody=lambda: pytest.fail("these rules know nothing of all nodes"),
    )
    return build_estimator(scenario.with_(rule=rule), place)


def readings(noise_std: float, steps: int) -> list[list[float | None]]:
    """One channel of an oscillator, `noise_std` times as noisy as the sensor says."""
    generator = np.random.default_rng(3)
    state, taken = np.array([1.0, 0.0]), []
    factor = np.linalg.cholesky(MODEL.process_noise_cov(0))
    for _ in range(steps):
        state = MODEL.transition(state, None, 0) + factor @ generator.standard_normal(2)
        taken.append([float(state[0] + 0.5 * noise_std * generator.standard_normal())])
    return taken


def factor_of(content) -> float:
    """The learnt variance over that of the data sheet."""
    return content.memory[0].learnt.variances[0]


def run(estimator, taken):
    content, failures = estimator.start(), ()
    for step, reading in enumerate(taken):
        content, more = estimator.begin_step(content, Measured(0, step, [reading]))
        content, _ = estimator.compose(content)
        content, fused = estimator.fuse(content, (None,))
        failures += (*more, *fused)
    return content, failures


@pytest.mark.parametrize("choice", [AdaptiveUnscented(), FuzzyUnscented()])
@pytest.mark.parametrize("rule", RULES)
def test_it_learns_that_a_sensor_has_become_noisy(rule, choice):
    content, failures = run(estimator_of(rule, build_filter(choice, 2)), readings(3.0, 400))
    assert failures == ()
    # The average spans fifty readings or thirty: its deviation is a fifth of it.
    assert np.sqrt(factor_of(content)) == pytest.approx(3.0, rel=0.35)


def test_it_never_believes_less_noise_than_the_data_sheet():
    content, _ = run(estimator_of("ci", LEARNING), readings(0.01, 100))
    assert factor_of(content) == 1.0


@pytest.mark.parametrize("rule", RULES)
def test_the_first_reading_is_taken_with_the_noise_of_the_data_sheet(rule):
    learning = estimator_of(rule, LEARNING)
    plain = estimator_of(rule, SigmaPointFilter(scaled_unscented(2)))
    measured = Measured(0, 0, [[0.3]])
    ours, _ = learning.begin_step(learning.start(), measured)
    theirs, _ = plain.begin_step(plain.start(), measured)
    np.testing.assert_array_equal(learning.belief(ours).mean, plain.belief(theirs).mean)
    np.testing.assert_array_equal(learning.belief(ours).cov, plain.belief(theirs).cov)
    assert learning.share_bytes == plain.share_bytes == len(learning.compose(ours)[1])


def test_a_learnt_noise_is_what_the_next_reading_is_taken_with():
    learning = estimator_of("local", LEARNING)
    content, _ = run(learning, readings(8.0, 60))
    loud = ScalarSensor(SENSOR.row, 0.5 * np.sqrt(factor_of(content)))
    plain = SigmaPointFilter(scaled_unscented(2))
    before = plain.predict(
        learning.belief(content), lambda x: MODEL.transition(x, None, 0), MODEL.process_noise_cov(0)
    )
    value, noise_cov = loud.interpret(np.array([2.0]))
    expected = plain.update(before, value, lambda x: loud.measure(x, 0), noise_cov).belief
    after, _ = learning.begin_step(content, Measured(0, 1, [[2.0]]))
    np.testing.assert_allclose(learning.belief(after).mean, expected.mean, rtol=1e-12)


def test_no_reading_teaches_nothing():
    content, _ = run(estimator_of("ci", LEARNING), [[None], [None]])
    assert content.memory == (None,)
    first, _ = run(estimator_of("ci", LEARNING), [[0.3]])
    then, _ = run(estimator_of("ci", LEARNING), [[0.3], [None], [None]])
    assert factor_of(first) == factor_of(then)


def test_nodes_that_begin_anew_forget_and_the_others_do_not():
    """Groups of sensors: nodes 0 and 2 have one, and node 1 another."""
    groups = (SensorGroup(np.array([0, 2]), SENSOR), SensorGroup(slice(1, 2), SENSOR))
    filters = LocalFilters(MODEL, groups, LEARNING)
    belief = Gaussian(np.zeros((4, 3, 2)), np.broadcast_to(np.eye(2), (4, 3, 2, 2)))
    taken = np.random.default_rng(1).uniform(5.0, 9.0, (4, 3, 1, 1))
    memory = filters.update(belief, taken, 0).memory
    after = forgotten(filters, memory, np.array([0]), 3)
    (pair, single), (new_pair, new_single) = (
        [known.learnt.variances for known in one if known is not None] for one in (memory, after)
    )
    assert (pair > 2).all() and (single > 2).all()
    np.testing.assert_array_equal(new_pair[:, 0], np.ones((4, 1)))
    np.testing.assert_array_equal(new_pair[:, 1], pair[:, 1])
    np.testing.assert_array_equal(new_single, single)
    assert forgotten(filters, (), np.arange(3), 3) == ()
