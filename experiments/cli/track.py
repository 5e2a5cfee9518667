"""`concord track`: several targets from detections without names, at a centre and at nodes."""

import dataclasses
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from concord.experiments.monte_carlo.intervals import Interval, mean_t, ratio_t
from concord.experiments.progress import progress
from concord.experiments.results.folder import make_folder
from concord.experiments.sweep.engines import engine_for
from concord.experiments.sweep.workers import WorkerLost
from concord.experiments.tracking.swarm_run import SwarmRun, run_swarm
from concord.experiments.user_errors import user_errors
from concord.scenarios.definitions.target_swarm import TargetSwarm

# Field of the scores, and its name in the table.
_ROWS = {
    "gospa_m": "GOSPA, m",
    "localisation_m": "  distance of tracked targets, RMS, m",
    "missed": "  missed targets",
    "false": "  false tracks",
    "ospa_m": "OSPA, m",
    "cardinality_error": "error of the number of targets",
    "identity_switches": "identity switches in a run",
    "steps_to_confirm": "steps to the first track",
}


@dataclass(frozen=True, kw_only=True)
class TrackOptions:
    """Which case, and how many runs of it."""

    swarm: Annotated[TargetSwarm, tyro.conf.arg(name="")] = field(default_factory=TargetSwarm)
    runs: int = 1
    """Independent runs; two or more give intervals of 95 %."""
    alone: bool = False
    """Let each node compute its own tracks, from scans in an order of its own, and compare the bits
    of nodes with equal records. Otherwise these share one computation, which saves time."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the tracks, tracks_<run>.nc each; it must not exist."""
    workers: int | None = None
    """Processes on this machine; one per core when left out."""
    json: bool = False
    """Print one JSON object instead of a table."""


def track_swarm(options: Annotated[TrackOptions, tyro.conf.arg(name="")]) -> None:
    """Track several targets from detections that do not say of which target they are.

    A centre has all scans at once. Each node has its own, and those that come over the bus.
    Cutoff 50 m and order 2 in all scores.
    """
    with user_errors():
        if options.runs < 1:
            raise ValueError(f"--runs {options.runs}: must be 1 or more")
        options.swarm.check()
        engine = engine_for(1 if options.runs == 1 else options.workers, None)
        folder = None if options.out is None else make_folder(options.out, "")
    cases = [
        dataclasses.replace(options.swarm, run=options.swarm.run + number)
        for number in range(options.runs)
    ]
    found: dict[int, SwarmRun] = {}
    try:
        with progress("runs", options.runs, as_json=options.json) as on_runs:
            for place, run in engine(partial(run_swarm, alone=options.alone, folder=folder), cases):
                found[place] = run
                on_runs(len(found))
    except WorkerLost as error:
        sys.stderr.write(f"concord: {error}\n")
        sys.exit(1)
    runs = [found[place] for place in range(options.runs)]
    if options.json:
        result = {"options": dataclasses.asdict(options.swarm), "runs": runs}
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
    else:
        _show(options.swarm, runs)


def _show(swarm: TargetSwarm, runs: Sequence[SwarmRun]) -> None:
    count = f"{len(runs)} run" + "s" * (len(runs) > 1)
    table = Table(
        "mean over steps", "centre", f"{swarm.nodes} nodes",
        title=f"{swarm.targets} targets, {swarm.steps} steps, {count}", title_justify="left",
    )  # fmt: skip
    for name, title in _ROWS.items():
        centre, nodes = _scores(runs, name)
        table.add_row(title, _text(mean_t(centre)), _text(mean_t(nodes)))
    Console(file=sys.stdout, width=100).print(table)
    centre, nodes = _scores(runs, "gospa_m")
    held, alike = (np.mean([getattr(run, name) for run in runs]) for name in ("held", "alike"))
    sys.stdout.write(
        f"GOSPA of the nodes over the centre's: {_text(ratio_t(nodes**2, centre**2))}.\n"
        f"After a step a node holds {held:.1%} of the scans of the last {swarm.window_steps} "
        f"steps; {alike:.1%} of the pairs of nodes have equal tracks, bit for bit.\n"
    )
    _show_bus(runs)
    compared = [run.compared for run in runs if run.compared is not None]
    if compared:
        pairs, different = (
            sum(getattr(one, name) for one in compared) for name in ("pairs", "different")
        )
        sys.stdout.write(
            f"{pairs} pairs of nodes had equal records; the tracks of {different} differ.\n"
        )
    approximated = sum(run.approximated for run in runs)
    if approximated:
        sys.stdout.write(
            f"{approximated} clusters of the centre were too large for the exact sum; their best "
            "hypotheses stand for all.\n"
        )


def _show_bus(runs: Sequence[SwarmRun]) -> None:
    frames, sent = (np.mean([getattr(run, name) for run in runs]) for name in ("frames", "bytes"))
    bus_time = runs[0].bus_time
    lasts = f"; its cycles last {bus_time:.1%} of the time" if bus_time else ""
    sys.stdout.write(f"The bus carries {frames:.4g} frames, {sent:.4g} bytes, a step{lasts}.\n")
    shortened = sum(run.shortened for run in runs)
    if shortened:
        sys.stdout.write(
            f"{shortened} scans had more detections than a record holds; the farthest are left "
            "out, and the tracker takes it that the scan reaches no farther.\n"
        )


def _scores(runs: Sequence[SwarmRun], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return one score (runs,) of the centre and of the nodes."""
    both = [[getattr(part, name) for part in (run.centre, run.nodes)] for run in runs]
    centre, nodes = np.array(both).T
    return centre, nodes


def _text(found: Interval) -> str:
    return "none" if np.isnan(found.value) else f"{found.value:.3g} {found.spread()}".rstrip()
