"""Clocks of two hosts are compared by asking: how far that can be wrong is known."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.runtime.processes import clock
from concord.runtime.processes.clock import ahead_s

# There and back, each way as long as it takes.
TRIPS = st.lists(st.tuples(st.floats(1e-4, 0.5), st.floats(1e-4, 0.5)), min_size=1, max_size=9)


class World:
    """Another host, on virtual time: its clock is ahead, and questions take their time."""

    def __init__(self, apart_s: float, trips: list[tuple[float, float]]) -> None:
        self.now_s = 1000.0
        self._apart_s, self._trips = apart_s, list(trips)

    def monotonic(self) -> float:
        return self.now_s

    def ask(self) -> float:
        there_s, back_s = self._trips.pop(0)
        self.now_s += there_s
        answer_s = self.now_s + self._apart_s
        self.now_s += back_s
        return answer_s


def compared(
    monkeypatch: pytest.MonkeyPatch, environment: World, ask: Callable, trips: int
) -> float:
    with monkeypatch.context() as patch:
        patch.setattr(clock.time, "monotonic", environment.monotonic)
        return ahead_s(ask, trips)


@given(st.floats(-1e5, 1e5), TRIPS)
def test_the_difference_is_wrong_by_half_the_shortest_way_at_most(
    apart_s: float, trips: list[tuple[float, float]]
):
    environment = World(apart_s, trips)
    with pytest.MonkeyPatch.context() as monkeypatch:
        told_s = compared(monkeypatch, environment, environment.ask, len(trips))
    shortest_s = min(there + back for there, back in trips)
    # Twice that, where it might also be one clock and is taken for one.
    bound_s = shortest_s / 2 if told_s else shortest_s
    assert abs(told_s - apart_s) <= bound_s + 1e-9


def test_one_clock_is_not_told_from_itself(monkeypatch: pytest.MonkeyPatch):
    environment = World(0.0, [(0.001, 0.004)])
    assert compared(monkeypatch, environment, environment.ask, 1) == 0.0


def test_questions_that_nobody_answers_say_nothing(monkeypatch: pytest.MonkeyPatch):
    environment = World(50.0, [(0.1, 0.1)])
    answers = iter([None, 0, None])
    asked = compared(
        monkeypatch, environment, lambda: None if next(answers) is None else environment.ask(), 3
    )
    assert asked == pytest.approx(50.0)
