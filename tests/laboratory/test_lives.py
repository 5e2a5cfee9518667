"""Lives: what it finds, and that a seed is a case and its run."""

from collections.abc import Callable

import msgspec
import pytest

from tests.experiments.command_support import Said
from tests.laboratory.bugs import FOUND, LIVES_BUGS, Bug, first_found, run_life
from tests.laboratory.lives.case import draw_lives
from tests.laboratory.lives.network import run_lives
from tests.laboratory.lives.virtual_clock import VirtualClock

pytestmark = pytest.mark.slow


def test_no_promise_breaks_and_what_happened_is_counted(laboratory: Callable[..., Said]):
    code, out, _ = laboratory("lives", "--seeds", "1..8", "--workers", "1", "--json")
    result = msgspec.json.decode(out)
    assert (code, result["failures"], result["cases"]) == (0, [], 8)
    assert result["estimates"] > 1000 and result["joins"] > 5


def test_cases_have_all_that_is_drawn():
    cases = [draw_lives(seed) for seed in range(1, 41)]
    assert {case.tempo is None for case in cases} == {False, True}
    names = {incident.name for case in cases for incident in case.incidents}
    assert names == {"kill", "restart", "stop", "stop environment", "forge"}
    words = {line.split()[1] for case in cases for line in case.changes}
    assert words == {"kill", "restart", "slow-cpu"}
    assert {boot.dies for case in cases for boot in case.boots} == {False, True}


def test_a_seed_is_a_case_and_its_run():
    assert run_lives(draw_lives(7)) == run_lives(draw_lives(7))
    assert draw_lives(7) != draw_lives(8)


@pytest.mark.parametrize("bug", LIVES_BUGS, ids=lambda bug: bug.name)
def test_every_planted_bug_is_found(bug: Bug, laboratory: Callable[..., Said]):
    found = first_found(bug, [FOUND.get(bug.name, 1)], run_life)
    assert found is not None
    # The same case keeps its promises without the bug.
    code, out, _ = laboratory("lives", "--seeds", str(found.seed), "--workers", "1")
    assert (code, "no promise broken" in out) == (0, True)


def test_a_mistake_is_told_before_anything_runs(laboratory: Callable[..., Said]):
    code, out, err = laboratory("lives", "--seeds", "9..3")
    assert (code, out) == (2, "") and "the lower first" in err


def test_the_virtual_clock_keeps_the_order_of_times_and_then_of_requests():
    clock, called = VirtualClock(), []
    for name, at_s in (("b", 2.0), ("a", 1.0), ("c", 2.0), ("late", 9.0)):
        clock.at(at_s, lambda name=name: called.append((name, clock.now_s)))
    clock.at(1.0, lambda: clock.at(0.5, lambda: called.append(("at once", clock.now_s))))
    clock.run(5.0, lambda: False)
    assert called == [("a", 1.0), ("at once", 1.0), ("b", 2.0), ("c", 2.0)]
