"""In which band the network's NEES lies in most runs: from runs, because the nodes' errors are not
independent of each other after they have agreed, and no table of chi-square tells it then.

`python -m experiments.nees_band` is the process that runs them, at the lowest priority, so that a
page that shows a running network does not slow it down.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

import msgspec
import numpy as np

from experiments.vectorised import simulate
from nodes.messages import Array
from scenarios.rules import is_certain
from scenarios.setup import Setup
from scenarios.vectorised import without_array_form

RUNS, SHARE = 100, 0.95
# Message by message a run costs thousands of times more: then fewer, or none.
_FEWER_RUNS, _MOST_NODE_STEPS = 20, 4000

Band = Callable[[Array], tuple[Array, Array] | None]


class Limits(msgspec.Struct):
    """Per step, between what values the mean NEES of the nodes lies in `SHARE` of the runs."""

    low: list[float]
    high: list[float]


def limits(setup: Setup, runs: int) -> Limits:
    """The band of a scenario, from runs 1000 and up: not the one that is shown."""
    histories = simulate(setup, range(1000, 1000 + runs), keep=())
    network = histories.nees.mean(axis=2)
    low, high = np.quantile(network, [(1 - SHARE) / 2, (1 + SHARE) / 2], axis=0)
    return Limits(low.tolist(), high.tolist())


class RunningBand:
    """The band of a scenario once its process is done; None before, and where there is none."""

    def __init__(self, setup: Setup) -> None:
        self._time_step_s = setup.time_step_s
        self._limits: Limits | None = None
        self._process: subprocess.Popen[bytes] | None = None
        scenario = setup.scenario
        in_messages = without_array_form(scenario) is not None
        too_long = in_messages and scenario.nodes * scenario.steps > _MOST_NODE_STEPS
        if is_certain(scenario) or too_long:
            return
        self._process = subprocess.Popen(
            [sys.executable, "-m", "experiments.nees_band"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        threading.Thread(target=self._await, args=(setup,), daemon=True).start()

    def _await(self, setup: Setup) -> None:
        assert self._process is not None, "a process was started"
        with self._process as process:
            assert process.stdin is not None and process.stdout is not None, "it has pipes"
            with suppress(BrokenPipeError):
                process.stdin.write(msgspec.json.encode(setup) + b"\n")
                process.stdin.flush()
            # Its standard input stays open: it ends with us, however we end.
            out = process.stdout.read()
        if process.returncode == 0:
            self._limits = msgspec.json.decode(out, type=Limits)

    def __call__(self, times: Array) -> tuple[Array, Array] | None:
        """Lower and upper limits at these times."""
        if self._limits is None:
            return None
        steps = np.round(times / self._time_step_s).astype(int)
        steps = np.clip(steps, 0, len(self._limits.low) - 1)
        return np.array(self._limits.low)[steps], np.array(self._limits.high)[steps]

    def close(self) -> None:
        """Stop computing it."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def main() -> None:
    """The process: a setup on a line of standard input, its limits on standard output; ends when
    standard input does."""
    os.nice(19)
    setup = msgspec.json.decode(sys.stdin.buffer.readline(), type=Setup)
    threading.Thread(target=_end_with_input, daemon=True).start()
    runs = RUNS if without_array_form(setup.scenario) is None else _FEWER_RUNS
    sys.stdout.buffer.write(msgspec.json.encode(limits(setup, runs)))


def _end_with_input() -> None:
    # Without a buffer, whose lock would be held when the interpreter ends.
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    main()
