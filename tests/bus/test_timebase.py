"""Which cycles of the bus carry rounds: against a search over all cycles, and by invariants."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from concord.bus.timebase import EVERY_CYCLE, Pace, Timebase

STEPS = 12
CYCLE_US = st.integers(100, 5000)
ROUNDS = st.integers(1, 4)
PERIODS = st.sampled_from([1, 2, 3, 4, 5, 8, 20])
# Whole cycles of a step, and what is left over in thousandths of a cycle.
STEP_CYCLES = st.tuples(st.integers(1, 300), st.integers(0, 999))


def timebase_of(cycle_us: int, step: tuple[int, int], rounds: int, period: int) -> Timebase:
    whole, thousandths = step
    step_us = cycle_us * (whole + thousandths / 1000)
    return Timebase(float(cycle_us), period, Pace(step_us, rounds))


def numbers_of(timebase: Timebase, rounds: int) -> np.ndarray:
    """(STEPS, rounds)."""
    cycles = range(STEPS * rounds)
    return np.array([timebase.bus_cycle(cycle) for cycle in cycles]).reshape(STEPS, rounds)


@given(CYCLE_US, STEP_CYCLES, ROUNDS, PERIODS)
def test_rounds_are_consecutive_cycles_after_the_measurement(
    cycle_us: int, step: tuple[int, int], rounds: int, period: int
):
    assume(step[0] >= rounds)
    timebase = timebase_of(cycle_us, step, rounds, period)
    numbers = numbers_of(timebase, rounds)
    assert (np.diff(numbers, axis=1) == 1).all()
    assert (np.diff(numbers.ravel()) >= 1).all()
    step_thousandths = 1000 * step[0] + step[1]
    for k, row in enumerate(numbers.tolist()):
        wait_thousandths = 1000 * row[0] - k * step_thousandths
        assert 0 <= wait_thousandths < 1000 * period
        assert timebase.wait_us(k) == pytest.approx(wait_thousandths * cycle_us / 1000, abs=1e-3)
        assert timebase.begins_us(k * rounds) == row[0] * cycle_us


@given(CYCLE_US, STEP_CYCLES, ROUNDS, PERIODS)
def test_a_step_begins_with_the_first_cycle_of_its_turn(
    cycle_us: int, step: tuple[int, int], rounds: int, period: int
):
    timebase = timebase_of(cycle_us, step, rounds, period)
    assume(timebase.waits_for_turn)
    numbers = numbers_of(timebase, rounds)
    for k, row in enumerate(numbers.tolist()):
        earlier = range(-(-k * (1000 * step[0] + step[1]) // 1000), row[0])
        assert all(cycle % period != k * rounds % period for cycle in earlier)
    assert (numbers.ravel() % period == np.arange(STEPS * rounds) % period).all()


@pytest.mark.parametrize(("step_cycles", "rounds"), [(200, 1), (200, 3), (64, 2), (8, 4)])
def test_no_turn_starves_where_steps_are_a_multiple_of_the_turns(step_cycles: int, rounds: int):
    """A frame with repetition 4 would never be sent if every step began in a multiple of 4."""
    timebase = timebase_of(1000, (step_cycles, 0), rounds, 4)
    turns = Counter((numbers_of(timebase, rounds) % 4).ravel().tolist())
    assert turns == dict.fromkeys(range(4), STEPS * rounds // 4)


def test_a_step_of_its_rounds_alone_uses_every_cycle():
    timebase = timebase_of(5000, (3, 0), 3, 4)
    assert [timebase.bus_cycle(cycle) for cycle in range(50)] == list(range(50))
    assert timebase.keeps_turns and timebase.cycles_of(10) == 30


def test_a_step_without_time_for_its_turn_begins_at_once():
    timebase = timebase_of(1000, (2, 500), 2, 3)
    assert not timebase.waits_for_turn and not timebase.keeps_turns
    assert numbers_of(timebase, 2)[:4].tolist() == [[0, 1], [3, 4], [5, 6], [8, 9]]
    # Two cycles with one round each: the second turn of two is never due at once.
    tight = timebase_of(1000, (2, 0), 1, 4)
    assert not tight.keeps_turns and numbers_of(tight, 1)[:3].tolist() == [[0], [2], [4]]
    # Five cycles with one round: turns of four go on by themselves.
    assert timebase_of(1000, (5, 0), 1, 4).keeps_turns


@pytest.mark.parametrize("step_s", [0.07, 0.1, 0.3, 1.1, 2.3])
def test_rounding_delays_no_step_by_a_cycle(step_s: float):
    timebase = Timebase(5000.0, 1, Pace(step_s * 1e6, 1))
    cycles = round(step_s * 200)
    for step in (1, 3, 999, 123_457, 10_000_019):
        assert timebase.bus_cycle(step) == step * cycles


def test_other_settings_go_on_in_the_time_of_the_bus():
    before = Timebase(1000.0, 1, Pace(10_000.0, 3))
    after = Timebase(1000.0, 2, Pace(10_000.0, 2, first_step=5, first_cycle=15))
    assert [before.bus_cycle(cycle) for cycle in (12, 13, 14)] == [40, 41, 42]
    # Cycle 15 is of an odd turn, 17 as well.
    assert [after.bus_cycle(cycle) for cycle in (15, 16, 17, 18)] == [51, 52, 61, 62]


@settings(max_examples=40)
@given(CYCLE_US, STEP_CYCLES, ROUNDS, PERIODS, st.data())
def test_ages_over_all_cycles_are_those_of_the_two_cycles(
    cycle_us: int, step: tuple[int, int], rounds: int, period: int, data: st.DataObject
):
    assume(step[0] >= rounds)
    timebase = timebase_of(cycle_us, step, rounds, period)
    numbers = numbers_of(timebase, rounds).ravel()
    rows = [
        data.draw(st.lists(st.integers(-1, (k + 1) * rounds - 1), min_size=3, max_size=3))
        for k in range(STEPS)
    ]
    for k, row in enumerate(timebase.ages_over_all(np.array(rows)).tolist()):
        last = (k + 1) * rounds - 1
        assert row == [-1 if age < 0 else numbers[last] - numbers[last - age] for age in rows[k]]


def test_a_bus_without_time_counts_rounds_alone():
    for timebase in (EVERY_CYCLE, Timebase(0.0, 4, Pace(1e6, 3))):
        assert [timebase.bus_cycle(cycle) for cycle in range(7)] == list(range(7))
        assert timebase.wait_us(3) == 0.0 and timebase.keeps_turns
    assert Timebase(0.0, 4, Pace(1e6, 3)).cycles_of(5) == 15
