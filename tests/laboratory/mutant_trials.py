"""Trials of mutants: each in a process of its own, forked from one that has imported all tests.

`python -m tests.laboratory.mutant_trials` reads mutants.json in the current folder, a copy of the
project with mutants in it, and writes a status for each mutant into statuses.json. It runs all fast
tests once, to learn which tests reach which function and how long each takes.
"""

import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import accumulate
from pathlib import Path
from typing import Any

import pytest
from mutmut.mutation.trampoline import set_mutant_under_test
from mutmut.state import state

MUTANTS, STATUSES = Path("mutants.json"), Path("statuses.json")
CAUGHT, SURVIVED, NOT_REACHED = "caught", "survived", "not reached"
# A longer test stands in no list of a function: one mutant would wait for it alone.
LONGEST_TEST_S = 10
FLAGS = ("-q", "--tb=no", "-p", "no:randomly", "-p", "no:cacheprovider")
FAST = ("-m", "not (slow or zenoh or browser)")


class TooSlow(BaseException):
    """A test takes longer than it may."""


def _ring(*_: object) -> None:
    raise TooSlow


@contextmanager
def within(seconds: int) -> Iterator[None]:
    """Raise `TooSlow` in what takes longer."""
    signal.signal(signal.SIGALRM, _ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)


class Reach:
    """Which tests reach which function, and how long each takes; tests that fail are left out."""

    def __init__(self) -> None:
        self.tests: dict[str, set[str]] = {}
        self.seconds: dict[str, float] = {}
        self._failed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self) -> Any:
        """Stop a test that takes too long."""
        try:
            with within(LONGEST_TEST_S):
                return (yield)
        except TooSlow:
            raise AssertionError("too slow for mutants") from None

    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> None:
        """Add a phase of a test."""
        name = item.nodeid
        self.seconds[name] = self.seconds.get(name, 0.0) + call.duration
        if call.excinfo is not None:
            self._failed.add(name)
        if call.when == "teardown":
            found = () if name in self._failed else tuple(state()._stats)
            for function in found:
                self.tests.setdefault(function, set()).add(name)
            state()._stats.clear()


def quickest(tests: list[str], seconds: dict[str, float], most_s: float) -> list[str]:
    """Return the quickest tests that take `most_s` together, and at least one."""
    order = sorted(tests, key=lambda name: (seconds[name], name))
    ends_s = accumulate(seconds[name] for name in order)
    kept = [name for name, end_s in zip(order, ends_s, strict=True) if end_s <= most_s]
    return kept or order[:1]


def tried(mutant: str, tests: list[str], longest_s: float) -> str:
    """Return the status of a mutant after these tests; a trial that hangs has caught it."""
    if not tests:
        return NOT_REACHED
    child = os.fork()
    if child == 0:
        _try(mutant, tests)
    end_s = time.monotonic() + longest_s
    while time.monotonic() < end_s:
        gone, status = os.waitpid(child, os.WNOHANG)
        if gone:
            return SURVIVED if status == 0 else CAUGHT
        time.sleep(0.02)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return CAUGHT


def _try(mutant: str, tests: list[str]) -> None:
    """Run tests in a forked process, and end it with their exit code."""
    code = 1
    try:
        os.setsid()
        nowhere = os.open(os.devnull, os.O_RDWR)
        for handle in (0, 1, 2):
            os.dup2(nowhere, handle)
        set_mutant_under_test(mutant)
        code = int(pytest.main([*FLAGS, "-x", *tests]))
    finally:
        os._exit(code)


def main() -> None:
    """Learn the reach of the tests, and try the mutants."""
    asked = json.loads(MUTANTS.read_text(encoding="utf-8"))
    os.environ |= {"MUTMUT_DEPENDENCY_DEPTH": "-1", "PY_IGNORE_IMPORTMISMATCH": "1"}
    set_mutant_under_test("stats")
    reach = Reach()
    pytest.main([*FLAGS, *FAST, *asked["tests"]], plugins=[reach])
    print(f"reach: {sum(reach.seconds.values()):.0f} s", flush=True)  # noqa: T201
    statuses: dict[str, str] = {}
    for mutant, places in asked["mutants"].items():
        tests = list(reach.tests.get(mutant.partition("__mutmut_")[0], ()))
        # The tests of the own folder, or those of the others where none of them reaches it.
        own = [name for name in tests if name.startswith(tuple(places))] or tests
        chosen = quickest(own, reach.seconds, asked["most_s"]) if own else []
        begin_s = time.monotonic()
        statuses[mutant] = tried(mutant, chosen, 4 * asked["most_s"])
        spent = f"{time.monotonic() - begin_s:.1f} s, {len(chosen)} tests"
        print(f"{mutant}: {statuses[mutant]} ({spent})", flush=True)  # noqa: T201
        STATUSES.write_text(json.dumps(statuses), encoding="utf-8")


if __name__ == "__main__":
    sys.path.insert(0, str(Path.cwd()))
    main()
