"""The strip of a run: its bins hold every step once, and its marks are where things happened."""

import re
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.panels.run_strip import MOST_BINS, RunStrip, binned
from concord.dashboard.theme import DARK
from concord.dashboard.view import View
from tests.dashboard.runs import event, frames_of, run_of

RUN = run_of("target-tracking", nodes=6, steps=30, loss=0.2)


@cache
def frames() -> list[StepFrame]:
    """The frames of the run, with the departure of a node."""
    return frames_of(RUN.stage, [event(9, what="left", node=2), *RUN.messages])


@given(st.sets(st.integers(0, 2000), min_size=1), st.integers(0, 10**6))
def test_each_step_is_in_one_bin_and_no_number_is_lost(steps: set[int], first: int):
    there = np.array(sorted(steps)) + first
    rmse, missed = np.sqrt(1.0 + there % 7), there % 3
    bins = binned(there, rmse, missed)
    assert 1 <= len(bins.rmse) <= MOST_BINS
    assert (np.diff(bins.edges) >= 1).all()
    assert bins.edges[0] == there[0]
    assert bins.edges[-1] == there[-1] + 1
    assert bins.missed.sum() == missed.sum()
    for low, high, found in zip(bins.edges[:-1], bins.edges[1:], bins.rmse, strict=True):
        inside = (low <= there) & (there < high)
        if inside.any():
            assert found == pytest.approx(np.sqrt(np.mean(rmse[inside] ** 2)))
        else:
            assert np.isnan(found)


def test_misses_events_and_the_shown_step_are_marked_in_their_bins():
    history, strip = FrameHistory(RUN.stage), RunStrip()
    # In parts: what was drawn before is not drawn twice.
    for part in (frames()[:10], frames()[10:]):
        history.add(part)
        html = strip.draw(RUN.stage, View(theme=DARK, step=12), history)
    lossy = [frame for frame in frames() if any(cycle.missed for cycle in frame.cycles)]
    assert 0 < len(lossy) == html.count('class="heat"')
    titles = re.findall(r"<title>(.*?)</title>", html, re.DOTALL)
    assert len(titles) == 30
    for frame, title in zip(frames(), titles, strict=True):
        senders = sum(len(cycle.missed) for cycle in frame.cycles)
        assert f"RMSE {frame.scores.rmse:.3g} m\n{senders} senders missed" in title
        assert ("was killed" in title) == (frame.step == 9)
    assert html.count('class="flag"') == len({one.step for one in history.log})
    assert [strip.step_of(number) for number in range(30)] == list(range(30))
