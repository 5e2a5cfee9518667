"""Comparison values for a shown run, from other runs of its scenario.

The values are the band that holds the network's NEES in most runs, and the error that no filter
with all readings can beat.

The band comes from runs because the nodes' errors are dependent after agreement, so a chi-square
table does not apply. This module is also the process that computes these runs apart from the shown
network.
"""

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import msgspec
import numpy as np

from concord.dashboard.frames.expected import Expected, nothing_expected
from concord.runtime.batched.build import without_array_form
from concord.runtime.interpreter import fresh_command, fresh_variables
from concord.scenarios.catalogue import definition_of, is_received
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.setup import Setup
from concord.studies.priority import give_way

RUNS, SHARE = 100, 0.95
# Message by message a run costs thousands of times more: then fewer, or none.
_FEWER_RUNS, _MOST_NODE_STEPS = 20, 4000
# The bound goes through nodes and steps one by one, and needs all readings in memory.
_MOST_BOUNDED = 50_000
_NICENESS = 10
# Beside a network that runs: so many times as long at rest as at work, because a low priority alone
# still empties the caches of the others.
_REST = 29.0


class Question(msgspec.Struct):
    """The scenario, and whether a network runs beside whose time is to be spared."""

    setup: Setup
    sparing: bool


class NeesRange(msgspec.Struct):
    """Per step: between what values the mean NEES of the nodes lies in `SHARE` of the runs, and the
    root of the trace of the posterior Cramer-Rao bound of the scored states (None: not defined)."""

    nees_low: list[float | None]
    nees_high: list[float | None]
    bound: list[float | None]


def told_by(setup: Setup, runs: int, rest: Callable[[int], None] = lambda done: None) -> NeesRange:
    """Return the values of runs 1000 and up, without the shown run. `rest` is called every step."""
    # The page of a network asks another process, and needs none of this itself.
    from concord.results.figures.run_frame import bound_of
    from concord.studies.monte_carlo.simulate import READINGS, simulate

    bounded = setup.scenario.nodes * setup.scenario.steps <= _MOST_BOUNDED
    keep = (READINGS,) if bounded else ()
    histories = simulate(setup, range(1000, 1000 + runs), keep=keep, on_progress=rest)
    network = histories.nees.mean(axis=2)
    # Runs of what was recorded once are all the same run: there is nothing to compare with.
    differing = np.ptp(network, axis=0) > 0
    low, high = np.quantile(network, [(1 - SHARE) / 2, (1 + SHARE) / 2], axis=0)
    low, high = (np.where(differing, limit, np.nan) for limit in (low, high))
    bound = np.full(len(low), np.nan)
    if bounded:
        states = list(definition_of(setup.scenario).score.states)
        variances = np.diagonal(bound_of(histories), axis1=-2, axis2=-1)
        bound = np.sqrt(variances[:, states].sum(axis=-1))
    return NeesRange(_plain(low), _plain(high), _plain(bound))


def _plain(values: np.ndarray) -> list[float | None]:
    """JSON knows no NaN."""
    return [float(value) if np.isfinite(value) else None for value in values]


def expected(told: NeesRange, time_step_s: float, times: np.ndarray) -> Expected:
    """Return the expected values at these times."""
    steps = np.clip(np.round(times / time_step_s).astype(int), 0, len(told.nees_low) - 1)
    columns = (told.nees_low, told.nees_high, told.bound)
    return Expected(*(np.array(column, dtype=np.float64)[steps] for column in columns))


class OtherRuns:
    """Values of other runs of a scenario; empty until their process is done."""

    def __init__(self, setup: Setup, sparing: bool) -> None:
        self._time_step_s = setup.time_step_s
        self._told: NeesRange | None = None
        self._process: subprocess.Popen[bytes] | None = None
        scenario = setup.scenario
        # More runs of an own scenario would run its code.
        if is_received(scenario):
            return
        in_messages = without_array_form(scenario) is not None
        too_long = in_messages and scenario.nodes * scenario.steps > _MOST_NODE_STEPS
        if is_set_valued(scenario) or too_long:
            return
        self._process = subprocess.Popen(
            fresh_command("concord.experiments.other_runs"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=fresh_variables(OPENBLAS_NUM_THREADS="1"),
            # A session of its own has a priority of its own.
            start_new_session=True,
        )
        # From outside: what it loads before it could say so itself takes as long as a few runs.
        with contextlib.suppress(ProcessLookupError):
            give_way(_NICENESS, self._process.pid)
        question = Question(setup, sparing)
        self._asking = threading.Thread(
            target=self._ask, args=(self._process, question), daemon=True
        )
        self._asking.start()

    def _ask(self, process: "subprocess.Popen[bytes]", question: Question) -> None:
        assert process.stdin is not None, "it was started with pipes"
        assert process.stdout is not None, "it was started with pipes"
        # A process that was ended tells nothing.
        with contextlib.suppress(OSError), process:
            process.stdin.write(msgspec.json.encode(question) + b"\n")
            process.stdin.flush()
            line = process.stdout.readline()
            if line.endswith(b"\n"):
                self._told = msgspec.json.decode(line, type=NeesRange)

    def __call__(self, times: np.ndarray) -> Expected:
        """Return the expected values at these times."""
        if self._told is None:
            return nothing_expected(times)
        return expected(self._told, self._time_step_s, times)

    def close(self) -> None:
        """Stop computing it."""
        if self._process is not None:
            self._process.kill()
            self._asking.join()


def main() -> None:
    """The process: a question in a line of standard input, which then stays open for as long as
    somebody wants to know; what the runs tell in a line of standard output."""
    question = msgspec.json.decode(sys.stdin.buffer.readline(), type=Question)
    setup = question.setup
    threading.Thread(target=_end_with_input, daemon=True).start()
    runs = RUNS if without_array_form(setup.scenario) is None else _FEWER_RUNS
    rest = _rest_after_work() if question.sparing else (lambda done: None)
    sys.stdout.buffer.write(msgspec.json.encode(told_by(setup, runs, rest)) + b"\n")
    sys.stdout.buffer.flush()


def _rest_after_work() -> Callable[[int], None]:
    """Rests in proportion to the processor time that was spent since the last rest."""
    worked_s = time.process_time()

    def rest(done: int) -> None:
        nonlocal worked_s
        time.sleep(_REST * (time.process_time() - worked_s))
        worked_s = time.process_time()

    return rest


def _end_with_input() -> None:
    """End this process when its parent has ended, for any reason."""
    # Without a buffer, whose lock would be held when the interpreter ends.
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    main()
