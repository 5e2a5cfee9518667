"""Account of a network of processes that died, hung or were overloaded: promises, and consistency.

It tells what was lost, whether the nodes agree, and whether those that stayed claim what they know.
"""

from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from benchmarks.measure import say
from concord.nodes.tempo import Tempo
from concord.results.records.netcdf_file import ARRAYS, read_dataset
from concord.results.records.trace import Trace
from concord.runtime.recording import read_recording
from concord.runtime.recording_repair import finish_recording
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.studies.audit.report import audit
from concord.studies.monte_carlo.simulate import simulate
from tests.experiments.support import trace_of, write_arrays

# A node that stayed has taken part in so many steps in a row. Runs without deaths, and their steps.
STAYED, CALM_RUNS, CALM_STEPS = 10, 40, 500


def spread(values: list[float] | np.ndarray, digits: int = 3) -> str:
    """Median, 99th percentile and largest."""
    return "/".join(f"{q:.{digits}f}" for q in np.quantile(values, [0.5, 0.99, 1.0]))


def audited(setup: Setup, folder: Path, tempo: Tempo | None) -> tuple[Trace, np.ndarray]:
    """Write the arrays of a recording, print what `concord audit` finds in them, and return the
    trace and the NEES (steps, N)."""
    finish_recording(folder / "run.mcap")
    trace = trace_of(setup, folder / "run.mcap")
    write_arrays(folder, setup, trace, tempo)
    for promise, finding in audit(folder).findings:
        mark = "BROKEN" if finding.broken else "holds"
        text = "; ".join(filter(None, (finding.note, finding.first)))
        say(f"  {mark:8}{promise.says}: {finding.checked} checked. {text}")
    return trace, read_dataset(folder / ARRAYS, ("nees",), "run it again")["nees"].values[0]


def account(setup: Setup, folder: Path, tempo: Tempo | None) -> None:
    """Print the audit, where the estimates and shares are that were not recorded, and whether the
    nodes agree and claim what they know."""
    trace, nees = audited(setup, folder, tempo)
    changes = Counter(
        msgspec.json.decode(data)["change"]["what"]
        for topic, data in read_recording(folder / "run.mcap")
        if topic == "event"
    )
    out = np.isnan(trace.mean[:, :, 0])
    nodes = range(setup.scenario.nodes)
    taking_part = np.array([[trace.history.is_in(i, k) for i in nodes] for k in range(trace.steps)])
    silent = ~trace.published[: trace.steps].all(axis=1)
    say(
        f"  {trace.steps} steps; told: {dict(changes)}; estimates missing {int(out.sum())}, while "
        f"out {int((~taking_part).sum())}, not accounted for {int((out & taking_part).sum())}"
    )
    say(
        f"  (node, step) without all its shares {int(silent.sum())}, not accounted for by being "
        f"out {int((silent & taking_part).sum())}"
    )
    apart = np.sqrt(np.nanvar(trace.mean, axis=1).mean(axis=-1))
    say(f"  disagreement: median {np.median(apart):.4g}, last step {apart[-1]:.4g}")
    cycles = cycles_to_agree(trace.mean, setup.scenario.rounds)
    agreed = cycles[np.isfinite(cycles)]
    say(
        f"  as near to the others as usual (95 % of the time) {spread(agreed, 0)} cycles after it "
        f"was let in; out again before that {len(cycles) - len(agreed)} times of {len(cycles)}"
    )
    say(f"  {consistency_of_survivors(setup, nees, taking_part)}")


def consistency_of_survivors(setup: Setup, nees: np.ndarray, taking_part: np.ndarray) -> str:
    """The mean NEES of the nodes that took part in the last `STAYED` steps, beside the range of a
    network without deaths; both arrays are (steps, N)."""
    stayed = sliding_window_view(taking_part, STAYED, axis=0).all(axis=-1)
    known = np.where(stayed, nees[STAYED - 1 :], np.nan)
    found = np.ma.masked_invalid(known).mean(axis=1).compressed()
    calm = prepare(setup.scenario.with_(steps=CALM_STEPS))
    without = simulate(calm, range(1, 1 + CALM_RUNS), keep=()).nees.mean(axis=2)[:, STAYED:]
    low, high = np.quantile(without, [0.025, 0.975])
    inside = np.mean((low <= found) & (found <= high))
    return (
        f"NEES of those that stayed: mean {found.mean():.3g}, without deaths {without.mean():.3g}; "
        f"in {inside:.1%} of the steps in the range of 95 % without deaths, {low:.2g} to {high:.2g}"
    )


def cycles_to_agree(mean: np.ndarray, rounds: int) -> np.ndarray:
    """Return for each return of a node the number of cycles until it agrees with the others.

    A node agrees when its distance from the average of all nodes is at most the distance that
    nodes keep in 95 of 100 steps. The number is infinite where the node was out again before.
    The means are (steps, N, n).
    """
    away = np.linalg.norm(mean - np.nanmean(mean, axis=1, keepdims=True), axis=-1)
    usual = np.nanquantile(away, 0.95)
    is_out = np.isnan(away)
    cycles = []
    for step, node in np.argwhere(is_out[:-1] & ~is_out[1:]):
        life = away[step + 1 :, node]
        life = life[: np.argmax(np.isnan(life))] if np.isnan(life).any() else life
        near = life <= usual
        cycles.append((1 + np.argmax(near)) * rounds if near.any() else np.inf)
    return np.array(cycles)
