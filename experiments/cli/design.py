"""`concord design`: the cheapest network that meets an error target, confirmed on fresh runs."""

import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import msgspec
import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from concord.experiments.cli.help import FIRST
from concord.experiments.cli.sweep import FILE_WIDTH
from concord.experiments.scenario_flags import FieldOptions, said_in
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.results.places import new_name
from concord.runtime.json_file import write_json
from concord.scenarios.scenario_options import scenario_with_known
from concord.studies.design.candidates import COSTS, Candidate, Cost, RefusedCandidate
from concord.studies.design.results import (
    Attempt,
    Design,
    check_place,
    command_for,
    design_of,
    nearest,
)
from concord.studies.design.search import Found, SearchTask, search
from concord.studies.design.space import Values, placements_of, space_of
from concord.studies.design.target import BusLimits, parse_target
from concord.studies.few_samples import few_runs, few_steps
from concord.studies.progress import progress
from concord.studies.sweep.engines import engine_for, workers_here
from concord.studies.sweep.specification import shown, specify
from concord.studies.sweep.workers import WorkerLost


@dataclass(frozen=True, kw_only=True)
class DesignOptions:
    """Target of the design, cost to minimise, and confidence."""

    target_rmse: Annotated[str, FIRST]
    """Error to be met: 1.5x-centralised, 2x-bound, or a number in the scenario's unit."""
    minimise: Annotated[Cost, FIRST] = "bytes"
    """Cost to minimise: bytes or microseconds of the bus per step, nodes that publish per cycle, or
    energy per step."""
    exact: Annotated[bool, FIRST] = False
    """Take errors from exact second moments where plant and rule have them, and from runs else."""
    latency_ms: float | None = None
    """Longest delay from a measurement to the end of the last share of its step."""
    load: float | None = None
    """Greatest share of a cycle in which the bus carries frames."""
    runs: Annotated[int, FIRST] = 100
    """Fresh runs that confirm the recommended network."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"]), FIRST] = None
    """JSON file for the result; runs/design-<date>.json when left out. It must not exist."""
    workers: Annotated[int | None, FIRST] = None
    """Processes on this machine; one per core when left out."""
    dask: str | None = None
    """Address of a Dask scheduler whose workers compute instead: tcp://HOST:8786."""
    dask_tls: Path | None = None
    """Folder with ca.pem, cert.pem and key.pem, for a scheduler at tls://HOST:8786."""
    json: Annotated[bool, FIRST] = False
    """Print one JSON object instead of tables."""


def design(
    fields: Annotated[FieldOptions, tyro.conf.arg(name="")],
    output: Annotated[DesignOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Find the cheapest network that meets an error target. Fields given are settled, or are looked
    for among the given values; graph, rule, weights, rounds, occupancy, schedule, formats of
    numbers and relay are open. The network must bear all placements given: runs take one after the
    other."""
    out = output.out or Path("runs") / f"{new_name('design')}.json"
    with user_errors():
        if out.exists():
            raise ValueError(f"--out {out}: exists and is never written over; choose another name")
        if output.runs < 2:
            raise ValueError(f"--runs {output.runs}: an interval needs at least 2")
        target, limits = parse_target(output.target_rmse), BusLimits(output.latency_ms, output.load)
        limits.check()
        specification = specify(said_in(fields))
        settled, space = space_of(specification)
        engine = engine_for(output.workers, output.dask, output.dask_tls)
        check_place(out)
        asked: dict[str, Any] = {**settled}
        for warning in (*few_steps(scenario_with_known(**asked)[0]), *few_runs(output.runs)):
            _say(f"warning: {warning}")
        shown_briefly = partial(progress, brief=True, as_json=output.json)
        task = SearchTask(
            target, output.minimise, settled, space, output.runs, engine,
            workers_here(output.workers, output.dask), _say, shown_briefly,
            placements_of(specification), limits, output.exact,
        )  # fmt: skip
    kept: list[Candidate] = []
    refused: list[RefusedCandidate] = []
    started = time.monotonic()
    try:
        with user_errors():
            found = search(task, kept, refused)
    except (KeyboardInterrupt, WorkerLost):
        if kept:
            done = Found(kept, refused, [])
            write_json(out, design_of(task, done, False))
            _say(f"interrupted; what was tried is in {out}")
        raise
    result = design_of(task, found, True)
    with user_errors():
        write_json(out, result)
    _show(result, output, out, time.monotonic() - started)
    if result.recommended is None:
        sys.exit(1)


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def _show(result: Design, options: DesignOptions, out: Path, seconds: float) -> None:
    if options.json:
        brief = msgspec.structs.replace(result, tried=[one for one in result.tried if one.front])
        whole = {**msgspec.to_builtins(brief), "result": str(out), "seconds": seconds}
        sys.stdout.write(msgspec.json.encode(whole).decode() + "\n")
        return
    console = plain_console(FILE_WIDTH)
    console.print(table(result))
    for line in lines(result):
        console.print(line, soft_wrap=True)
    runs = sum(one.runs for one in (*result.tried, *result.attempts) if not one.exact)
    exact = sum(one.exact for one in result.tried)
    counted = f"{exact} of them exact, {runs} runs" if exact else f"{runs} runs"
    console.print(
        f"{len(result.tried)} candidates, {counted} in {seconds:.0f} s, seed {result.seed}; "
        f"result in {out}; `concord plot {out}` draws the front", soft_wrap=True,
    )  # fmt: skip


def table(result: Design) -> Table:
    """Return the front: what no other candidate beats, the cheapest first."""
    grid = Table(
        title=f"front: {COSTS[result.minimise].meaning} against error, of {len(result.tried)} "
        "candidates; ± half of the 95 % interval",
        title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0),
    )  # fmt: skip
    line = sorted((one for one in result.tried if one.front), key=lambda one: -one.error.value)
    fields = list(dict.fromkeys(field for one in line for field in one.values))
    for field in fields:
        grid.add_column(field)
    unit = result.unit if result.target.reference == "unit" else f"x {result.target.reference}"
    costs = dict.fromkeys(("bytes", result.minimise))
    figures = ("ANEES", *(COSTS[cost].heading for cost in costs), "age bound, steps", "runs")
    for heading in (f"RMSE {unit}", *figures):
        grid.add_column(heading, justify="right")
    for one in line:
        chosen = (_brief(one.values.get(field, "-")) for field in fields)
        spent = (f"{one.costs[cost]:.3g}" for cost in costs)
        error = f"{one.error.value:.3g} {one.error.spread()}"
        age = "none" if one.age_bound_steps is None else str(one.age_bound_steps)
        runs = "exact" if one.exact else str(one.runs)
        grid.add_row(*chosen, error, f"{one.anees.value:.2f}", *spent, age, runs)
    return grid


def _brief(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else shown(value)


def lines(result: Design) -> list[str]:
    """Return the recommendation with its confidence, or the best that can be reached."""
    target = result.target.shown(result.unit)
    said = [
        f"tried {_in_words(one.values)} {_found(one)}: "
        f"{'meets' if one.meets else 'does not surely meet'} the target"
        for one in result.attempts
    ]
    if result.recommended is not None:
        values = {**result.settled, **result.recommended.values}
        again = command_for("sweep", {**values, "seed": result.seed + 1}, ["--runs 50"])
        return [
            *said,
            f"recommended for {target}, sparing {result.minimise}:",
            f"  {result.recommended.command}",
            *_preference(result.recommended),
            *_spread(result.recommended),
            *_age(result.recommended),
            *(f"warning: {warning}" for warning in result.recommended.warnings),
            f"under another seed: {again}",
        ]
    best = nearest(result)
    words = _in_words(best.values)
    interval = f"{best.error.value:.3g} ({best.error.low:.3g} to {best.error.high:.3g})"
    return [
        *said,
        f"no candidate surely meets {target}; the best reached is {interval} in {best.runs} runs: "
        f"{words}",
    ]


def _found(one: Attempt) -> str:
    if one.exact:
        return f"exactly, without runs: {one.error.value:.3g}"
    return (
        f"on {one.runs} fresh runs: {one.error.value:.3g}, at most {one.error.high:.3g} with "
        f"{100 * one.confidence:.4g} % confidence"
    )


def _in_words(values: Values) -> str:
    return ", ".join(f"{field} {shown(value)}" for field, value in values.items())


def _preference(attempt: Attempt) -> list[str]:
    if attempt.instead_of is None:
        return []
    return [
        f"preferred to {_in_words(attempt.instead_of)}, which costs the same within the spread: "
        "its age of information has no bound"
    ]


def _spread(attempt: Attempt) -> list[str]:
    errors = attempt.by_placement
    each = ", ".join(f"{one.placement}: {one.error.value:.3g}" for one in errors)
    return [f"by placement of the sensors: {each}"] if errors else []


def _age(attempt: Attempt) -> list[str]:
    """The age of information, with its bound."""
    if attempt.age is None:
        return []
    bound, observed, why, lost = attempt.age
    if bound is None:
        limit = f"no bound, since {why}"
    else:
        limit = f"at most {bound} steps" + (f", since {why}" if why else " by schedule and graph")
    never = f"; {100 * lost:.2g} % of the records never came to a node" if lost else ""
    return [f"age of information: {limit}; observed: at most {observed} steps{never}"]
