"""Plain lines of progress: how far, and how long it still takes at the rate so far."""

import json
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace

import pytest

from concord.experiments.__main__ import main
from concord.studies import progress as module
from concord.studies.progress import progress, time_left


class Clock:
    """A clock of a work whose every step takes so many seconds."""

    def __init__(self, step_s: float) -> None:
        self.step_s, self.done = step_s, 0

    def __call__(self) -> float:
        return 100.0 + self.step_s * self.done


def told(total: int, clock: Clock, first: int = 1) -> Iterator[str]:
    left = time_left(total, clock)
    for clock.done in range(first, total + 1):
        yield left(clock.done)


def test_the_time_left_is_named_after_a_twentieth_and_until_little_is_left():
    words = list(told(200, Clock(1.0)))
    assert words[:9] == [""] * 9
    assert words[9] == ", about 3 min left" and words[99] == ", about 100 s left"
    assert words[189] == ", about 10 s left" and set(words[190:]) == {""}
    assert not any(told(200, Clock(0.01)))


def test_the_rate_is_that_of_this_start():
    """A sweep that goes on finds most of its runs done: they took no time now."""
    words = list(told(200, Clock(60.0), first=150))
    assert words[0] == "" and words[1] == ", about 49 min left"
    assert next(iter(told(3000, Clock(60.0)))) == ""
    assert list(told(3000, Clock(60.0)))[149] == ", about 48 h left"


@pytest.mark.parametrize(
    ("step_s", "brief", "lines"),
    [
        (0.001, False, ["8 of 40", "16 of 40", "24 of 40", "32 of 40", "40 of 40"]),
        (0.001, True, []),
        (2.0, True, ["2 of 40, about 76 s left", "8 of 40, about 64 s left",
                     "16 of 40, about 48 s left", "24 of 40, about 32 s left",
                     "32 of 40, about 16 s left"]),
        (2.0, False, ["2 of 40, about 76 s left", "8 of 40, about 64 s left",
                      "16 of 40, about 48 s left", "24 of 40, about 32 s left",
                      "32 of 40, about 16 s left", "40 of 40"]),
    ],
)  # fmt: skip
def test_lines_name_what_is_done_and_the_time_left(
    step_s: float, brief: bool, lines: list[str], capsys, monkeypatch
):
    clock = Clock(step_s)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=clock))
    with progress("runs", 40, brief) as on_run:
        for clock.done in range(1, 41):
            on_run(clock.done)
    assert capsys.readouterr().err.splitlines() == [f"runs: {line}" for line in lines]


def test_lines_of_long_work_are_two_minutes_apart(capsys, monkeypatch):
    clock = Clock(60.0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=clock))
    with progress("runs", 20) as on_run:
        for clock.done in range(1, 21):
            on_run(clock.done)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[1] for line in lines] == [str(done) for done in range(2, 21, 2)]


@pytest.mark.parametrize(("step_s", "told"), [(0.5, [1, 3, 5, 7, 9, 10]), (2.0, [*range(1, 11)])])
def test_events_are_json_lines_one_a_second_at_most_and_one_at_the_end(
    step_s: float, told: list[int], capsys, monkeypatch
):
    clock = Clock(step_s)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=clock))
    with progress("runs", 10, as_json=True) as on_run:
        for clock.done in range(1, 11):
            on_run(clock.done)
    events = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [event.pop("done") for event in events] == told
    # The clock is exact, so the rate is, from the second call on.
    left = [event.pop("seconds_left") for event in events]
    assert left == [None, *(step_s * (10 - done) for done in told[1:])]
    assert all(later < earlier for earlier, later in pairwise(left[1:]))
    assert all(event == {"event": "progress", "of": "runs", "total": 10} for event in events)


def test_a_sweep_that_prints_json_has_json_events(tmp_path, capsys):
    words = ["--scenario", "oscillator", "--nodes", "2", "--steps", "5", "--runs", "2"]
    main(["sweep", *words, "--workers", "1", "--json", "-o", str(tmp_path / "s.nc")])
    said = capsys.readouterr()
    assert json.loads(said.out)["computed_pieces"]
    [*_, last] = [line for line in said.err.splitlines() if line.startswith("{")]
    assert json.loads(last) == {
        "event": "progress", "of": "runs", "done": 2, "total": 2, "seconds_left": 0.0,
    }  # fmt: skip
