"""The fault `slow-cpu`: processor time that a node spends, and bits that it leaves as they are."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.runtime.processes.node.real_time import SlowProcessor
from tests.experiments.support import small


class Counted:
    """Processor time of which each question takes a millionth of a second."""

    def __init__(self) -> None:
        self.used_s = 0.0

    def __call__(self) -> float:
        self.used_s += 1e-6
        return self.used_s


@given(st.lists(st.tuples(st.floats(1e-4, 1e-2), st.floats(0, 20)), min_size=1, max_size=5))
def test_work_takes_as_many_times_as_long(pieces: list[tuple[float, float]]):
    used = Counted()
    processor = SlowProcessor(used)
    for work_s, factor in pieces:
        before_s = used.used_s
        used.used_s += work_s
        processor.work(factor)
        assert used.used_s - before_s == pytest.approx(max(factor, 1) * work_s, abs=1e-4)


def test_it_is_processor_time_and_not_a_pause():
    processor, begun_s = SlowProcessor(), time.thread_time()
    while time.thread_time() < begun_s + 0.02:
        pass
    processor.work(5.0)
    used_s = time.thread_time() - begun_s
    assert used_s >= 5 * 0.02


def test_in_lockstep_it_changes_no_bit():
    plain, slow = (
        read_trace(setup, in_memory(setup))
        for setup in (
            small(graph="ring", steps=8),
            small(graph="ring", steps=8, changes=("2 slow-cpu 1 50", "5 slow-cpu 1 0")),
        )
    )
    np.testing.assert_array_equal(plain.mean, slow.mean)
    np.testing.assert_array_equal(plain.cov, slow.cov)
    assert plain.counters == slow.counters
