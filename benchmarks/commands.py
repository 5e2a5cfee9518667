"""Whole commands beside the network that they compute, in processor time."""

import os
import subprocess
import tempfile
import time
from collections.abc import Callable

from benchmarks.measure import BenchmarkFigures, figure, in_turns, median_us, ratio, say
from concord.runtime.drivers import in_memory
from concord.runtime.interpreter import fresh_command, fresh_variables
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate

TURNS, RUNS = 5, 200
NETWORK = ("--nodes", "20")
SMALL = ("--scenario", "oscillator", "--nodes", "4", "--steps", "30")
LABELLED = ("--rule", "labelled", "--schedule", "dynamic", "--occupancy", ".25")
_NETWORK = scenario_of(nodes=20)
_LABELLED = scenario_of(nodes=20, rule="labelled", schedule="dynamic", occupancy=0.25)
_SMALL = scenario_of(scenario="oscillator", nodes=4, steps=30)

_PYTHON = "import concord as cc; cc.simulate(cc.scenario('oscillator', nodes=6, steps=10))"


def command(module: str, *arguments: str) -> Callable[[], float]:
    """Return what runs a module in an empty folder and returns its processor seconds."""
    line = fresh_command(module, *arguments)

    def run() -> float:
        with tempfile.TemporaryDirectory() as folder:
            process = subprocess.Popen(
                line,
                cwd=folder,
                env=fresh_variables(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode:
                raise SystemExit(f"{' '.join(line)} ended with {process.returncode}")
        return used.ru_utime + used.ru_stime

    return run


def concord(*arguments: str) -> Callable[[], float]:
    """Return the same of a command of concord."""
    return command("concord", *arguments)


def once(statement: str) -> Callable[[], float]:
    """Return the same of a statement of Python."""
    return command("timeit", "-n", "1", "-r", "1", statement)


def timed(work: Callable[[], object]) -> Callable[[], float]:
    """Return what does a work in this process and returns its processor seconds."""

    def run() -> float:
        started = time.process_time()
        work()
        return time.process_time() - started

    return run


def network(setup: Setup) -> Callable[[], float]:
    """Return what runs a network in this process, message by message."""
    return timed(lambda: in_memory(setup))


def main() -> BenchmarkFigures:
    """Print and return processor seconds of each command, and how many times its network's."""
    many = prepare(_NETWORK)
    nothing = once("pass")
    rows: dict[str, tuple[Callable[[], float], Callable[[], float]]] = {
        "list": (concord("list"), nothing),
        "cc.simulate, 6 nodes, 10 steps": (once(_PYTHON), nothing),
        "run, 4 nodes, 30 steps": (concord("run", *SMALL), network(prepare(_SMALL))),
        "run, 20 nodes": (concord("run", *NETWORK), network(many)),
        "run, labelled": (concord("run", *NETWORK, *LABELLED), network(prepare(_LABELLED))),
        "run, processes": (concord("run", *NETWORK, "--driver", "processes"), network(many)),
        f"run, {RUNS} runs": (
            concord("run", *NETWORK, "--driver", "batched", "--runs", str(RUNS)),
            timed(lambda: simulate(many, range(RUNS), keep=())),
        ),
    }
    results: BenchmarkFigures = {}
    say(f"commands, processor time; {TURNS} turns")
    say(f"  {'':<34}{'s':>8}{'x its network, or x an empty Python':>38}")
    for name, (whole, own) in rows.items():
        given = in_turns({"own": own, "whole": whole}, TURNS)
        beside = ratio(given["whole"], given["own"])
        spread = f"{beside.value:.2f} ({beside.low:.2f} - {beside.high:.2f})"
        say(f"  {name:<34}{median_us(given['whole']) / 1e6:>8.2f}{spread:>38}")
        results[f"{name} s"] = figure(given["whole"], "s", "less")
        results[f"{name} x"] = figure(
            [a / b for a, b in zip(given["whole"], given["own"], strict=True)], "x", "less"
        )
    return results
