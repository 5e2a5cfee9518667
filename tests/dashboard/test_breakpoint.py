"""Conditions at which a run stops: their words, and the steps at which they hold."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.dashboard.seeking.breakpoint import QUANTITIES, read_breakpoint
from tests.dashboard.runs import run_of

RUN = run_of("target-tracking", nodes=6, steps=40, loss=0.2, changes=("25 kill 2",))


def steps_of(words: str) -> list[int]:
    condition = read_breakpoint(words, RUN.stage)
    return [frame.step for frame in RUN.frames if condition.holds(frame)]


@given(st.floats(0.01, 100.0), st.sampled_from(["<", "<=", ">", ">="]))
def test_a_comparison_is_that_of_the_numbers_of_the_charts(limit: float, sign: str):
    compare = {"<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal}[sign]
    for word, name in (("rmse", "rmse"), ("nees", "nees"), ("disagreement", "spread")):
        values = np.array([getattr(frame.scores, name) for frame in RUN.frames])
        expected = [int(step) for step in np.flatnonzero(compare(values, limit))]
        assert steps_of(f"{word}{sign}{limit!r}") == expected
        assert steps_of(f"  {word.upper()}  {sign} {limit!r} ") == expected


def test_nodes_have_quantities_of_their_own_and_the_network_has_the_largest_or_the_sum():
    errors = np.array([frame.scores.error for frame in RUN.frames])
    assert steps_of("error 3 > 5") == np.flatnonzero(errors[:, 3] > 5).tolist()
    assert steps_of("error 03 > 5") == steps_of("error 3 > 5")
    assert steps_of("error > 5") == np.flatnonzero(errors.max(axis=1) > 5).tolist()
    assert steps_of("down 2") == steps_of("silent 2") == steps_of("down") == list(range(25, 40))
    assert steps_of("silent") == steps_of("silent > 0")
    assert steps_of("down >= 2") == []
    lost = [frame.step for frame in RUN.frames if any(cycle.missed for cycle in frame.cycles)]
    assert 0 < len(lost) < 40
    assert steps_of("missed") == lost


def test_and_binds_more_than_or():
    a, b, c = (set(steps_of(words)) for words in ("rmse > 3", "missed", "down"))
    assert set(steps_of("rmse > 3 and missed or down")) == (a & b) | c
    assert set(steps_of("down or rmse > 3 and missed")) == c | (a & b)
    assert 0 < len((a & b) | c) < 40


def test_a_rejection_holds_in_its_step():
    run = run_of("target-tracking", nodes=6, steps=20, changes=("8 corrupt 0.5",))
    frames = run.frames
    condition = read_breakpoint("rejected", run.stage)
    told = {one.step for frame in frames for one in frame.events if "rejected" in one.text}
    assert told
    assert {frame.step for frame in frames if condition.holds(frame)} == told


@pytest.mark.parametrize("word", QUANTITIES)
def test_each_quantity_has_a_number_in_some_step(word: str):
    known = [QUANTITIES[word].value(frame, None) for frame in RUN.frames]
    assert np.isfinite(known).any()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("", "unknown quantity ''"),
        ("nes > 10", "did you mean 'nees'"),
        ("nees = 10", "nees =: nees is of the whole network"),
        ("nees > ten", "after the quantity come <, <=, > or >= and a number"),
        ("nees >", "after the quantity come"),
        ("error 6 > 1", "there is no such node; nodes are 00 to 05"),
        ("rmse 3 > 1", "rmse is of the whole network; leave 3 out"),
        ("rmse > 1 and", "unknown quantity ''"),
    ],
)
def test_words_that_mean_nothing_are_refused_with_a_cure(words: str, told: str):
    with pytest.raises(ValueError, match=re.escape(told)):
        read_breakpoint(words, RUN.stage)
