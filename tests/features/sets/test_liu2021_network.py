"""`liu2021-network`: what it is made of, what it refuses, and that its drivers agree."""

import numpy as np
import pytest

from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.bounded_network import BoundedNetwork, on_the_bound
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import is_set_valued
from tests.experiments.support import scenario, small

NAME = "liu2021-network"
GAUSSIAN_RULES = ("ci", "wac")


def plant(**changes) -> BoundedNetwork:
    made = definition_named(NAME).plant(scenario(NAME, **changes))
    assert isinstance(made, BoundedNetwork)
    return made


def test_the_network_reads_the_outputs_of_the_example_in_turn():
    network = plant(nodes=6)
    rng = np.random.default_rng(0)
    state, noise = rng.standard_normal(4), rng.uniform(-1, 1, (6, 1, 1))
    noise[:] = noise[0]
    read = network.observe(state, noise, step=7)
    outputs = liu2021.SYSTEM.observe(state, noise[0, 0], 7)
    np.testing.assert_allclose(read[:, 0, 0], outputs[[0, 1, 2, 3, 0, 1]])


def test_sensors_state_their_bounds():
    network = plant(nodes=4)
    for node in range(4):
        sensor = network.sensor(node)
        for step in range(50):
            rows, noise, half_widths = sensor.bounded_rows(step)
            assert abs(noise[0, 0]) <= sensor.noise_bound * (1 + 1e-12)
            assert half_widths.tolist() == [0.0]
            state = np.ones(4)
            exact = sensor.measure(state, step)
            np.testing.assert_allclose(rows @ state, exact)
            ends = [
                liu2021.SYSTEM.observe(state, np.array([end]), step)[node] for end in (-1.0, 1.0)
            ]
            np.testing.assert_allclose(ends - exact, noise[0, 0] * np.array([-1.0, 1.0]))


def test_matched_noise_is_on_the_bound_and_printed_noise_is_printed():
    rng = np.random.default_rng(0)
    np.testing.assert_allclose(np.linalg.norm(on_the_bound(rng, 20, 3), axis=-1), 1.0)
    draws = plant(noise="paper").draw(lambda *_: rng, 5)
    printed = 0.3 * np.sin(-np.arange(5.0)) / np.sqrt(10)
    np.testing.assert_allclose(draws.process[:, 0], printed)
    np.testing.assert_allclose(draws.measurement[:, 2, 0, 0], printed)
    state, centre, shape = plant(noise="paper").initial(draws.initial)
    np.testing.assert_array_equal(state, [0.15, 0.16, 0.1, -0.2])
    np.testing.assert_array_equal(centre, 0.0)
    np.testing.assert_array_equal(shape, np.eye(4))


def test_the_control_keeps_the_state_where_numbers_mean_something():
    network, law = plant(), liu2021.Stabiliser()
    rng = np.random.default_rng(1)
    state, largest = np.ones(4), 0.0
    for step in range(1000):
        control, _ = law.control(state, law.initial_memory, step)
        state = network.advance(state, control, rng.choice([-1.0, 1.0], 1), step)
        largest = max(largest, np.abs(state).max())
    assert largest < 100


def test_what_cannot_hold_the_truth_is_refused():
    with pytest.raises(ValueError, match="unknown hold 'raw'"):
        prepare(scenario(NAME, hold="raw"))
    with pytest.raises(ValueError, match="has no bound"):
        prepare(scenario("oscillator", rule="ellipsoid"))
    with pytest.raises(ValueError, match="nodes 0 to 5"):
        prepare(scenario(NAME, control="6"))
    with pytest.raises(ValueError, match=r"preset|noise"):
        prepare(scenario(NAME, noise="papre"))


def test_set_rules_are_certain_and_gaussian_rules_run_on_it_too():
    assert is_set_valued(scenario(NAME))
    assert is_set_valued(scenario(NAME, rule="zonotope"))
    for rule in GAUSSIAN_RULES:
        asked = small(NAME, rule=rule)
        assert not is_set_valued(asked.scenario)
