"""A network in real time on a machine that is too slow.

The script runs sixteen nodes at a multiple of the machine's capacity, with the fault `slow-cpu`. It
prints how old estimates were when they were sent and when the next ones replaced them.
"""

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from benchmarks.measure import say
from concord.nodes.commands import in_words
from concord.nodes.tempo import Tempo
from concord.results.figures.timing_figures import figures_of, lines
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from tests.laboratory.accounts import audited
from tests.laboratory.running import PROC, Running, oscillators

WARM_S, MEASURED_S, END_S = 3.0, 5.0, 120.0


@dataclass(frozen=True)
class OverloadOptions:
    """How long, and how much."""

    minutes: float = 5.0
    """Time under load."""
    times: float = 3.0
    """Demand, as a multiple of what the processors of this machine give."""
    nodes: int = 16
    """Size of the network."""
    processors: float | None = None
    """Processors of this machine, where a control group allows less than all of them."""


def main_thread_s(pid: int) -> float:
    """Return the processor time that the main thread of a process has used."""
    fields = (PROC / str(pid) / "task" / str(pid) / "stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def demand(network: Running, nodes: int) -> float:
    """Return how many processors the main threads of all nodes use."""
    pids = [network.pids[str(node)] for node in range(nodes)]
    before_s, began_s = sum(map(main_thread_s, pids)), time.monotonic()
    time.sleep(MEASURED_S)
    return (sum(map(main_thread_s, pids)) - before_s) / (time.monotonic() - began_s)


def overload(options: Annotated[OverloadOptions, tyro.conf.arg(name="")]) -> None:
    """Run a network at a multiple of the machine's capacity, and print what it cost."""
    setup = oscillators(options.nodes, "4-regular", 1)
    tempo = tempo_of(setup, None)
    seconds = WARM_S + MEASURED_S + 60 * options.minutes
    setup = prepare(setup.scenario.with_(steps=int(seconds / tempo.step_s)))
    with tempfile.TemporaryDirectory() as folder:
        _overload(options, setup, tempo, Path(folder))


def _overload(options: OverloadOptions, setup: Setup, tempo: Tempo, folder: Path) -> None:
    network = Running(setup, "overload", folder, tempo=tempo)
    time.sleep(WARM_S)
    processors = options.processors or len(os.sched_getaffinity(0))
    used = demand(network, options.nodes)
    factor = options.times * processors / used
    for node in range(options.nodes):
        answer = network.client.command(in_words(f"slow-cpu {node} {factor:g}".split()))
        assert answer.accepted, answer.detail
    network.client.close()
    if not network.ended_within(60 * options.minutes + END_S) or network.failure:
        raise SystemExit(f"the network did not end by itself: {network.failure}")
    say(
        f"{options.nodes} nodes, {setup.scenario.steps} steps of {tempo.step_s * 1e3:g} ms; "
        f"{used:.2f} of {processors:g} processors without the fault, slow-cpu {factor:.1f}: "
        f"{options.times:g} times the machine"
    )
    messages = network.recorded()
    trace, nees = audited(setup, folder, tempo)
    say("\n".join(lines(figures_of(tempo, messages, trace.counters, trace.estimate_age_s))))
    came = np.isfinite(nees)
    ages_s = trace.estimate_age_s
    assert ages_s is not None, "a run in real time has them"
    say(
        f"estimates {int(came.sum())} of {came.size}; NEES mean {nees[came].mean():.2f}, 99 % "
        f"{np.quantile(nees[came], 0.99):.2f}; oldest estimate of each node when it was sent, s: "
        + ", ".join(f"{age:.2f}" for age in np.nanmax(ages_s, axis=0))
    )
