"""One seed, a stream per run, purpose and node: nobody's noise depends on who else is there."""

from functools import partial

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.drivers import in_memory
from scenarios.catalogue import kind_of, kinds
from scenarios.scenario import Scenario
from scenarios.setup import generator, prepare
from tests.experiments.support import scenario, small

SIMULATED = [name for name, kind in kinds().items() if kind.all_steps is None]
KEYS = st.tuples(
    st.integers(0, 2**63),
    st.integers(0, 2**31),
    st.sampled_from(["initial", "process", "measurement", "placement"]),
    st.integers(0, 999),
)


def numbers(seed: int, run: int, purpose: str, node: int) -> bytes:
    asked = scenario(seed=seed, run=run)
    return generator(asked, purpose, node).standard_normal(4).tobytes()


@given(KEYS, KEYS)
def test_streams_are_equal_exactly_when_their_keys_are(one: tuple, other: tuple):
    assert (numbers(*one) == numbers(*other)) == (one == other)


def test_neighbouring_streams_are_independent():
    """Seeds, runs and nodes are small numbers in a row: correlations within 5 sigma of zero."""
    size = 4000
    streams = np.array(
        [
            generator(scenario(seed=seed, run=run), purpose, node).standard_normal(size)
            for seed in (1, 2)
            for run in (0, 1)
            for purpose in ("process", "measurement")
            for node in (0, 1, 2)
        ]
    )
    correlation = np.corrcoef(streams) - np.eye(len(streams))
    assert np.abs(correlation).max() < 5 / np.sqrt(size)
    assert np.abs(streams.mean(axis=1)).max() < 5 / np.sqrt(size)
    assert np.abs(streams.var(axis=1) - 1).max() < 5 * np.sqrt(2 / size)


def draws_of(asked: Scenario):
    kind = kind_of(asked.name)
    return kind.plant(asked).draw(partial(generator, asked), asked.steps)


def test_a_nodes_noise_does_not_depend_on_the_number_of_nodes():
    few = draws_of(scenario("oscillator", nodes=3, steps=20))
    many = draws_of(scenario("oscillator", nodes=17, steps=20))
    np.testing.assert_array_equal(few.measurement, many.measurement[:, :3])
    np.testing.assert_array_equal(few.process, many.process)
    np.testing.assert_array_equal(few.initial, many.initial)


@pytest.mark.parametrize("name", SIMULATED)
def test_a_longer_run_begins_like_a_shorter_one(name: str):
    nodes = kind_of(name).defaults.nodes
    short = draws_of(scenario(name, nodes=nodes, steps=4))
    long = draws_of(scenario(name, nodes=nodes, steps=9))
    np.testing.assert_array_equal(short.measurement, long.measurement[:4])
    np.testing.assert_array_equal(short.process, long.process[:4])


@pytest.mark.parametrize("name", SIMULATED)
def test_the_same_seed_gives_the_same_messages_and_another_does_not(name: str):
    asked = msgspec.structs.replace(kind_of(name).defaults, steps=3)
    first = in_memory(prepare(asked))
    assert in_memory(prepare(asked)) == first
    for changes in ({"seed": asked.seed + 1}, {"run": asked.run + 1}):
        assert in_memory(prepare(msgspec.structs.replace(asked, **changes))) != first


def test_rule_and_schedule_change_no_noise():
    """Rules are compared on the same truth and the same readings."""
    plain = in_memory(small())
    other = in_memory(small(rule="wac", rounds=1, graph="complete"))
    for kind in ("truth", "measured"):
        ours, theirs = ([m for m in ms if m[0].startswith(kind)] for ms in (plain, other))
        assert sorted(ours) == sorted(theirs)
