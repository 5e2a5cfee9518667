"""The frames that are kept, and the numbers that are charted of them."""

from itertools import pairwise

import numpy as np
import pytest

from concord.dashboard.frames import history
from concord.dashboard.frames.history import FrameHistory, state_table
from tests.dashboard.runs import run_of

RUN = run_of("oscillator", nodes=4, steps=60)


def kept(frames) -> FrameHistory:
    whole = FrameHistory(RUN.stage)
    whole.add(frames)
    return whole


def test_a_step_is_found_and_one_that_was_left_out_gives_the_one_before():
    every_third = kept(RUN.frames[::3])
    assert every_third.at(9).step == 9
    assert every_third.at(11).step == 9
    assert every_third.at(-5).step == 0
    assert every_third.at(999).step == 57
    assert [frame.step for frame in every_third.until(10, 2)] == [6, 9]


def test_charts_are_thinned_and_end_with_the_shown_step():
    sample = kept(RUN.frames).sampled(47, 10)
    assert len(sample) <= 10
    assert sample[-1] is RUN.frames[47]
    assert len({after.step - before.step for before, after in pairwise(sample)}) == 1


def test_charts_leave_the_unscored_beginning_out_once_there_is_more():
    first = RUN.stage.score.first_step
    assert kept(RUN.frames).sampled(59, 1000)[0].step == first
    assert kept(RUN.frames).sampled(max(first - 1, 5), 1000)[0].step == 0
    assert kept(RUN.frames).sampled(59, 1000, 4)[0].step == 56


def test_states_are_truth_estimate_and_deviation_of_a_node():
    table = state_table(kept(RUN.frames).sampled(30, 1000), node=2, state=1)
    frame = RUN.frames[30]
    expected = (frame.truth[1], frame.belief.mean[2, 1], np.sqrt(frame.belief.cov[2, 1, 1]))
    np.testing.assert_allclose(table[-1], expected)


def test_memory_has_a_limit(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(history, "_MOST_FRAMES", 100)
    short = FrameHistory(RUN.stage)
    for _ in range(3):
        short.add(f._replace(step=f.step + len(short)) for f in RUN.frames)
    assert len(short) <= 125
    assert short.last_step == short.at(10**9).step
