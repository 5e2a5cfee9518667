"""`concord run`: one scenario, one driver, one folder of results, one table of figures."""

import sys
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import UseAppendAction

from concord.disk import RunFailed
from concord.experiments.cli.collect import (
    FiguresForm,
    ResultOptions,
    end_by,
    finish,
    trace_with_progress,
)
from concord.experiments.cli.help import FIRST
from concord.experiments.page_options import LOOPBACK, check_place
from concord.experiments.page_process import PageProcess
from concord.experiments.run_many import run_many
from concord.experiments.scenario_flags import ScenarioFlags, resolved
from concord.experiments.user_errors import user_errors
from concord.nodes.tempo import Tempo
from concord.results.folder import BATCHED, Description, describe, make_folder, write_description
from concord.results.places import new_name
from concord.results.records.netcdf_file import RECORDING
from concord.results.run_results import Captures, check_captures
from concord.results.smoothing import check_smoothing
from concord.runtime.drivers import DRIVERS, RunPace, over_processes
from concord.runtime.network.links import names, ports_from
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import require
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from concord.scenarios.warnings import warnings_of
from concord.studies.few_samples import few_runs, few_steps
from concord.studies.memory import check_address_space, check_files, check_memory
from concord.studies.progress import progress

REALTIME = "realtime"


@dataclass(frozen=True, kw_only=True)
class RunOptions(ResultOptions):
    """How and where to run."""

    driver: Annotated[Literal["in-process", "processes", "batched", "realtime"], FIRST] = (
        "in-process"
    )
    """Where nodes run: in-process (all in one), processes (one per node, over zenoh, in lockstep),
    batched (many runs at once as arrays), realtime (processes that keep the bus's time)."""
    cycle_stretch: float | None = None
    """How many times longer a cycle lasts on the clock than on the bus, for --driver realtime; so
    that it lasts as long as the step allows, 100 ms at most, when left out."""
    runs: Annotated[int, FIRST] = 1
    """Number of runs, from --run on, for --driver batched."""
    covariances: bool = False
    """Keep full covariances of many runs, and not their traces alone."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"]), FIRST] = None
    """Folder for the results; runs/<name> when left out. It must not exist."""
    port: int | None = None
    """First of consecutive loopback ports for --driver processes or realtime, 0 for free ones; left
    out, processes talk over unix sockets that no other user can open."""
    dashboard: Annotated[bool, FIRST] = False
    """Show a run over processes in the browser. It waits a minute for a browser, and the page stays
    after the run until Ctrl-C."""
    http_port: int = 8080
    """Port of the dashboard; the next free one if it is taken, any free one for 0."""
    public_name: UseAppendAction[tuple[str, ...]] = ()
    """Name under which a proxy shows the page; repeat it for several."""


def run(
    scenario: Annotated[ScenarioFlags, tyro.conf.arg(name="")],
    output: Annotated[RunOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Run a network, and print how well each of its nodes did."""
    with user_errors():
        _check(output)
        found = resolved(scenario)
        check_memory(found, output.runs, messages=output.driver != BATCHED)
        if output.driver in ("processes", REALTIME):
            check_files(output.driver, found.nodes)
        setup = prepare(found)
        captures = Captures(output.capture == "all", output.capture_nodes)
        check_captures(setup, captures)
        if output.smooth:
            check_smoothing(setup)
        if output.port:
            ports_from(output.port, names(setup.neighbours))
        description, folder = _begun(setup, output, output.out)
    tempo = _tempo(output, setup)
    if tempo is not None:
        sys.stderr.write(
            f"real time: a cycle every {tempo.cycle_s * 1e3:.3g} ms ({tempo.stretch:.3g} x the "
            f"bus's), a step every {tempo.step_s * 1e3:.4g} ms\n"
        )
    few = few_runs(output.runs) if output.runs > 1 else ()
    for warning in (*warnings_of(setup), *few_steps(setup.scenario), *few):
        sys.stderr.write(f"warning: {warning}\n")
    if output.driver == BATCHED:
        shown = FiguresForm(output.json, output.verbose)
        found = run_many(setup, output.runs, folder, description, output.covariances, shown)
        end_by(found.verdict)
        return
    with closing(PageProcess(output.http_port, output.public_name)) as page:
        while True:
            pace = _watched(setup, output, description.run, folder, page)
            with user_errors():
                trace = trace_with_progress(folder, description, output.json)
            shown = FiguresForm(output.json, output.verbose)
            found = finish(folder, description, trace, pace, shown, captures, output.smooth)
            if not page.stay():
                end_by(found.verdict)
                return
            with user_errors():
                description, folder = _begun(setup, output, _next_folder(output.out))


def _begun(setup: Setup, output: RunOptions, out: Path | None) -> tuple[Description, Path]:
    """Make the folder of a run, described; return its description and the folder.

    Raises:
        ValueError: `out` exists, or cannot be made.
    """
    name = new_name(setup.scenario.name)
    description = describe(name, output.driver, setup, _tempo(output, setup))
    # Described first: a folder is never without its description.
    folder = make_folder(out, name)
    write_description(folder, description)
    sys.stderr.write(f"seed {setup.scenario.seed}; results in {folder}\n")
    return description, folder


def _next_folder(out: Path | None) -> Path | None:
    """Return the folder of the next of several runs: `out-2`, `out-3` and so on."""
    if out is None:
        return None
    return next(
        folder
        for number in count(2)
        if not (folder := out.with_name(f"{out.name}-{number}")).exists()
    )


def _watched(
    setup: Setup, output: RunOptions, name: str, folder: Path, page: PageProcess
) -> RunPace:
    """Run a setup, with its page beside it if that is asked for; return its pace."""
    pace, tempo = RunPace(None, None), _tempo(output, setup)
    try:
        steps = setup.scenario.steps
        shown = progress(setup.scenario.name, steps, as_json=output.json)
        with shown as on_step, user_errors():
            driver = DRIVERS.get(output.driver, partial(over_processes, tempo=tempo))
            if output.dashboard:
                driver = partial(over_processes, on_paused=partial(page.start, folder))
            pace = driver(setup, name, folder / RECORDING, output.port, on_step)
            page.tell_end()
            if output.dashboard:
                # A network that waits for people has no pace of its own.
                pace = pace._replace(steps_per_second=None)
    except RunFailed as error:
        page.outlive_network()
        raise RunFailed(f"{error}; `concord collect {folder}` shows what was done") from error
    except KeyboardInterrupt:
        # After an interrupt, the user need not wait for arrays and figures.
        sys.stderr.write(f"interrupted; `concord collect {folder}` shows what was done\n")
        raise
    return pace


def _tempo(options: RunOptions, setup: Setup) -> Tempo | None:
    return tempo_of(setup, options.cycle_stretch) if options.driver == REALTIME else None


def _check(options: RunOptions) -> None:
    """Refuse options of another driver.

    Raises:
        ValueError: naming the option, its value and the cure.
    """
    require(options.runs >= 1, "runs", options.runs, "at least 1")
    if options.driver in ("processes", REALTIME):
        check_address_space(options.driver)
    many = options.runs > 1 or options.covariances
    if many and options.driver != BATCHED:
        option = f"--runs {options.runs}" if options.runs > 1 else "--covariances"
        raise ValueError(
            f"{option} with --driver {options.driver}: it goes through one run, message by "
            f"message; use --driver {BATCHED}, or leave it out"
        )
    if options.dashboard and options.driver != "processes":
        raise ValueError(
            f"--dashboard with --driver {options.driver}: only a network of processes can be "
            "watched as it runs; use --driver processes, or show the run with concord replay"
        )
    if options.dashboard:
        check_place(LOOPBACK, options.http_port, options.public_name)
    if options.driver == BATCHED and (options.capture != "used" or options.capture_nodes):
        option = "--capture-nodes" if options.capture_nodes else f"--capture {options.capture}"
        raise ValueError(
            f"{option} with --driver {BATCHED}: it passes no frames; use --driver in-process, or "
            "leave it out"
        )
    if options.driver == BATCHED and options.smooth:
        raise ValueError(
            f"--smooth with --driver {BATCHED}: it smooths one run; use --driver in-process, or "
            "leave it out"
        )
    if options.cycle_stretch is not None and options.driver != REALTIME:
        raise ValueError(
            f"--cycle-stretch {options.cycle_stretch:g} with --driver {options.driver}: nothing is "
            f"timed there; use --driver {REALTIME}, or leave it out"
        )
    if options.port is not None and options.driver not in ("processes", REALTIME):
        raise ValueError(
            f"--port {options.port} with --driver {options.driver}: only processes talk over "
            "ports; use --driver processes, or leave --port out"
        )
