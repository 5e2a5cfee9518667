"""Which step is shown when: recordings play at the plant's pace, live pages follow or stay."""

import pytest

from concord.dashboard.player import Extent, play_live, play_recorded
from concord.dashboard.view import View

EXTENT = Extent(0, 99, 3, growing=False)


def test_a_recording_plays_at_the_pace_of_the_plant():
    view = View()
    for _ in range(100):
        play_recorded(view, EXTENT, 0.1, time_step_s=0.5)
    assert view.step + view.cursor / 3 == pytest.approx(20.0, abs=1e-6)


def test_speed_is_a_factor_and_the_end_stops():
    view = View(speed=4.0)
    play_recorded(view, EXTENT, 2.0, time_step_s=0.5)
    assert view.step == 16
    play_recorded(view, EXTENT, 1000.0, time_step_s=0.5)
    assert (view.step, view.playing) == (99, False)


def test_a_recording_that_is_still_read_waits_at_its_end():
    view = View()
    play_recorded(view, EXTENT._replace(growing=True), 1000.0, time_step_s=0.5)
    assert view.playing


def test_a_recording_at_its_end_plays_from_its_beginning():
    view = View(playing=False, follow=False, step=99)
    view.play(20, 99)
    assert (view.step, view.playing) == (20, True)
    play_recorded(view, EXTENT, 0.5, time_step_s=0.5)
    assert view.step == 21
    view.playing = False
    view.play(20, 99)
    assert view.step == 21


def test_the_end_is_shown_also_while_a_recording_plays():
    view = View(step=7)
    assert view.playing
    view.go_to_end()
    play_recorded(view, EXTENT, 0.1, time_step_s=0.5)
    assert (view.step, view.playing) == (99, False)


def test_a_paused_recording_stays_at_its_step_and_sweeps_the_cycles_once():
    view = View(playing=False, follow=False, step=7)
    for _ in range(100):
        play_recorded(view, EXTENT, 0.2, time_step_s=0.5)
    assert view.step == 7
    assert 2 < view.cursor < 3
    assert not play_recorded(view, EXTENT, 0.2, time_step_s=0.5)


def test_a_live_page_follows_unless_somebody_looks_back():
    view = View()
    assert play_live(view, EXTENT, 0.1, paused=False)
    assert view.step == 99
    view.follow, view.step = False, 40
    play_live(view, EXTENT._replace(last=150), 0.1, paused=False)
    assert view.step == 40


def test_what_memory_has_lost_cannot_be_shown():
    view = View(follow=False, step=3)
    play_live(view, Extent(50, 99, 3, False), 0.1, paused=False)
    assert view.step == 50


def test_a_loop_plays_between_its_steps_again_and_again():
    view = View(step=50, follow=False)
    view.loop_here(True, 0, 99)
    assert view.loop == (50, 99)
    view.step = 53
    view.loop_here(False, 0, 99)
    assert view.loop == (50, 53)
    seen: list[int] = []
    for _ in range(12):
        play_recorded(view, EXTENT, 0.5, time_step_s=0.5)
        seen.append(view.step)
    assert seen == [50, 51, 52, 53] * 3
    # An end before the beginning, and a beginning after the end, leave no empty loop.
    view.step = 20
    view.loop_here(False, 0, 99)
    assert view.loop == (0, 20)
    view.step = 60
    view.loop_here(True, 0, 99)
    assert view.loop == (60, 99)
    view.step = 99
    view.play(0, 99)
    play_recorded(view, EXTENT, 0.5, time_step_s=0.5)
    assert (view.step, view.playing) == (60, True)
