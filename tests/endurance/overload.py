"""A network in real time on a machine that is too slow: `python -m tests.endurance.overload`.

The script runs sixteen nodes at a multiple of the machine's capacity, with the fault `slow-cpu`. It
prints how old estimates were when they were sent and when the next ones replaced them.
"""

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from benchmarks.measure import say
from concord.nodes.commands import in_words
from concord.results.figures.timing_figures import figures_of, lines
from concord.results.folder import ARRAYS, describe, write_arrays
from concord.results.records.netcdf_file import read_dataset
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.tempo import tempo_of
from concord.studies.audit.report import audit
from tests.endurance.running import PROC, Running
from tests.experiments.support import trace_of

WARM_S, MEASURED_S, END_S = 3.0, 5.0, 120.0


@dataclass(frozen=True)
class Options:
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


def overload(options: Options, folder: Path) -> None:
    """Run the network, and print what it cost."""
    wanted = {"nodes": options.nodes, "graph": "4-regular"}
    setup = prepare(definition_named("oscillator").defaults.with_(**wanted))
    tempo = tempo_of(setup, None)
    seconds = WARM_S + MEASURED_S + 60 * options.minutes
    setup = prepare(setup.scenario.with_(steps=int(seconds / tempo.step_s)))
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
    trace = trace_of(setup, folder / "run.mcap")
    found = figures_of(tempo, messages, trace.counters, trace.estimate_age_s)
    say("\n".join(lines(found)))
    write_arrays(folder, describe("overload", "realtime", setup, tempo), trace)
    account(folder)


def account(folder: Path) -> None:
    """Print what the audit finds, and the consistency of the estimates that came."""
    for promise, finding in audit(folder).findings:
        mark = "BROKEN" if finding.broken else "holds"
        text = "; ".join(filter(None, (finding.note, finding.first)))
        say(f"{mark:8}{promise.says}: {finding.checked} checked. {text}")
    arrays = read_dataset(folder / ARRAYS, ("nees", "estimate_age"), "run it again")
    nees = arrays["nees"].values
    ages_s = arrays["estimate_age"].values
    came = np.isfinite(nees)
    say(
        f"estimates {int(came.sum())} of {came.size}; NEES mean {nees[came].mean():.2f}, 99 % "
        f"{np.quantile(nees[came], 0.99):.2f}; oldest estimate of each node when it was sent, s: "
        + ", ".join(f"{age:.2f}" for age in np.nanmax(ages_s, axis=0))
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as kept:
        overload(tyro.cli(Options), Path(kept))
