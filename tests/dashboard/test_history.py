"""The frames that are kept, and the numbers that are charted of them."""

import numpy as np
import pytest

from dashboard import history
from dashboard.history import History
from tests.dashboard.runs import frames_of, run_of

STAGE, MESSAGES = run_of("oscillator", nodes=4, steps=60)
FRAMES = frames_of(STAGE, MESSAGES)


def kept(frames) -> History:
    whole = History(STAGE)
    whole.add(frames)
    return whole


def test_a_step_is_found_and_one_that_was_left_out_gives_the_one_before():
    every_third = kept(FRAMES[::3])
    assert every_third.at(9).step == 9
    assert every_third.at(11).step == 9
    assert every_third.at(-5).step == 0
    assert every_third.at(999).step == 57
    assert [frame.step for frame in every_third.until(10, 2)] == [6, 9]


def test_charts_are_thinned_and_end_with_the_shown_step():
    times, columns = kept(FRAMES).columns(47, 10)
    assert len(times) <= 10
    assert times[-1] == FRAMES[47].time_s
    assert columns["rmse"][-1] == FRAMES[47].scores.rmse


def test_charts_leave_the_unscored_beginning_out_once_there_is_more():
    first = STAGE.score.first_step
    times, _ = kept(FRAMES).columns(59, 1000)
    assert times[0] == pytest.approx(first * STAGE.setup.time_step_s)
    early, _ = kept(FRAMES).columns(max(first - 1, 5), 1000)
    assert early[0] == 0.0


def test_states_are_truth_estimate_and_deviation_of_a_node():
    _, table = kept(FRAMES).states(30, 1000, node=2, state=1)
    frame = FRAMES[30]
    expected = (frame.truth[1], frame.belief.mean[2, 1], np.sqrt(frame.belief.cov[2, 1, 1]))
    np.testing.assert_allclose(table[-1], expected)


def test_memory_has_a_limit(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(history, "_MOST_FRAMES", 100)
    short = History(STAGE)
    for _ in range(3):
        short.add(f._replace(step=f.step + len(short)) for f in FRAMES)
    assert len(short) <= 125
    assert short.last_step == short.at(10**9).step
