"""Streams of many runs at once are those of numpy's seed sequences, one by one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from concord.runtime.batched.streams import beginnings, streams_of
from concord.scenarios.setup import generator
from tests.experiments.support import scenario

KEYS = st.one_of(st.integers(0, 9), st.integers(0, 2**32 - 1), st.integers(2**128, 2**200))
CODES = st.integers(0, 2**32 - 1)


@given(KEYS, st.lists(KEYS, min_size=1, max_size=4), CODES, st.lists(CODES, min_size=1, max_size=4))
def test_what_generators_begin_with_is_what_seed_sequences_give(seed, runs, code, nodes):
    states = beginnings(seed, runs, code, np.array(nodes, dtype=np.uint32))
    for run, of_run in zip(runs, states, strict=True):
        for node, state in zip(nodes, of_run, strict=True):
            sequence = np.random.SeedSequence(seed, spawn_key=(run, code, node))
            assert state.tolist() == sequence.generate_state(4, np.uint64).tolist()


@given(st.integers(0, 2**64), st.integers(0, 2**40), st.integers(1, 5), st.integers(0, 12))
def test_a_stream_is_that_of_its_run_alone(seed, run, nodes, node):
    asked = scenario("oscillator", seed=seed, run=run, nodes=nodes)
    stream = streams_of(asked, (0, run))(1, "measurement", node)
    alone = generator(asked, "measurement", node)
    assert stream.standard_normal(5).tolist() == alone.standard_normal(5).tolist()
