"""`concord setup`, `router`, `environment`, `node` and `up`: one network on several hosts.

All hosts get the same setup file; the environment refuses a node with another file
(docs/deployment.md).
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import tyro

from concord.experiments.cli.collect import FiguresForm, finish
from concord.experiments.scenario_flags import ScenarioFlags, resolved
from concord.experiments.user_errors import user_errors
from concord.features.hosts.host_place import place_of, read_setup, take_part
from concord.nodes.commands import Kill, Restart
from concord.results.folder import describe, make_folder, write_description
from concord.results.places import new_name
from concord.results.records.netcdf_file import RECORDING
from concord.results.run_results import completed
from concord.runtime.drivers import RunPace
from concord.runtime.network.links import (
    ENVIRONMENT,
    RECORDER,
    checked_endpoints,
    checked_run,
    key_file,
)
from concord.runtime.processes.job import Happened, Job
from concord.scenarios.preparation import prepare
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from concord.scenarios.user.trust import trust
from concord.studies.progress import progress

# How often a router looks whether it is to end.
_LOOK_S = 0.5


@dataclass(frozen=True, kw_only=True)
class SetupOptions:
    """Setup file to write."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The file to write; it must not exist."""
    driver: Literal["processes", "realtime"] = "processes"
    """processes: in lockstep; realtime: by the clock."""
    cycle_stretch: float | None = None
    """How many times longer a cycle lasts on the clock than on the bus, for --driver realtime."""
    name: str | None = None
    """Name of the run, part of every key; a new one when left out."""


def setup(
    scenario: Annotated[ScenarioFlags, tyro.conf.arg(name="")],
    options: Annotated[SetupOptions, tyro.conf.arg(name="")],
) -> None:
    """Work out a scenario and write it down, for the hosts of a network."""
    with user_errors():
        if options.cycle_stretch is not None and options.driver != "realtime":
            raise ValueError(
                f"--cycle-stretch {options.cycle_stretch:g} with --driver {options.driver}: "
                "nothing is timed there; use --driver realtime, or leave it out"
            )
        prepared = prepare(resolved(scenario))
        _check_changes(prepared)
        tempo = tempo_of(prepared, options.cycle_stretch) if options.driver == "realtime" else None
        name = checked_run(
            new_name(prepared.scenario.name) if options.name is None else options.name
        )
        description = describe(name, options.driver, prepared, tempo)
        text = msgspec.json.format(msgspec.json.encode(description), indent=2)
        try:
            with options.out.open("xb") as file:
                file.write(text + b"\n")
        except OSError as error:
            raise ValueError(
                f"--out {options.out}: cannot be written ({error.strerror}); choose another file"
            ) from None
    sys.stderr.write(f"{options.out}: run {name}, nodes 0 to {prepared.scenario.nodes - 1}\n")


def _check_changes(prepared: Setup) -> None:
    for step, command in script_of(prepared.scenario):
        if isinstance(command, Kill | Restart):
            raise ValueError(
                f"--changes: step {step} ends or starts a process, which on several hosts is for "
                "those who start them; leave kill and restart out"
            )


@dataclass(frozen=True, kw_only=True)
class RouterOptions:
    """Where it listens, and to whom it keeps a link."""

    listen: str
    """Its endpoint, such as tcp/10.0.0.1:7447; tls/... with --keys."""
    connect: tuple[str, ...] = ()
    """Endpoints of routers on other hosts; each pair needs it on one side."""
    keys: Path | None = None
    """Its file of `concord keys`: router-HOST.json."""


def router(options: Annotated[RouterOptions, tyro.conf.arg(name="")]) -> None:
    """Pass on the messages of a network's processes, on one of its hosts."""
    # A call for help need not load zenoh.
    from concord.runtime.network.zenoh_transport import LinkError, start_router

    with user_errors():
        has_keys = options.keys is not None
        checked_endpoints("--listen", [options.listen], has_keys)
        if options.connect:
            checked_endpoints("--connect", options.connect, has_keys)
        own = "a router needs its own file of `concord keys`, router.json or router-HOST.json"
        keys = None if options.keys is None else key_file(options.keys, own)
        try:
            session = start_router(options.listen, keys, options.connect)
        except LinkError as error:
            raise ValueError(f"--listen {options.listen}: {error}") from None
    sys.stderr.write(f"router at {options.listen}\n")
    try:
        # The kernel may give a signal to a thread of zenoh, which would not end a `signal.pause`.
        while True:
            time.sleep(_LOOK_S)
    finally:
        session.close()


@dataclass(frozen=True, kw_only=True)
class HostOptions:
    """How the processes of this host join."""

    setup: tyro.conf.Positional[Path]
    """The file of `concord setup`, the same on every host."""
    connect: tuple[str, ...] = ()
    """Endpoints of routers, such as tcp/10.0.0.1:7447; the first that answers is taken."""
    keys: Path | None = None
    """Folder with the files of `concord keys` for the processes of this host; needs tls/..."""
    trust: Path | None = None
    """The setup file, where the code that it names may run on this host."""


@dataclass(frozen=True, kw_only=True)
class EnvironmentOptions(HostOptions):
    """Folder for the results."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the results; runs/<name of the run> when left out. It must not exist."""
    json: bool = False
    """Print one JSON object instead of a table."""


def environment(options: Annotated[EnvironmentOptions, tyro.conf.arg(name="")]) -> None:
    """Run the environment and recorder processes on this host until the run ends."""
    with user_errors():
        trust(options.trust)
        description = read_setup(options.setup)
        place = place_of([RECORDER, ENVIRONMENT], options.connect, options.keys)
        folder = make_folder(options.out, description.run)
        write_description(folder, description)
    sys.stderr.write(f"run {description.run}; results in {folder}\n")
    job = Job(
        description.setup,
        description.run,
        str(folder / RECORDING),
        None,
        description.tempo,
        place,
    )
    scenario = description.setup.scenario
    with progress(scenario.name, scenario.steps, as_json=options.json) as on_step:

        def on_event(happened: Happened) -> None:
            if happened.what == "step":
                on_step(happened.step)

        take_part(job, folder, on_event)
    with user_errors():
        trace = completed(folder, description)
    finish(folder, description, trace, RunPace(None, None), FiguresForm(options.json, True))


@dataclass(frozen=True, kw_only=True)
class NodeOptions(HostOptions):
    """Which nodes are on this host."""

    nodes: tyro.conf.Positional[tuple[int, ...]]
    """Their numbers, one process each."""
    peer_timeout: float = 60.0
    """Seconds that a node waits without the environment before it ends."""


def node(options: Annotated[NodeOptions, tyro.conf.arg(name="")]) -> None:
    """Run some nodes of a network on this host until the run ends."""
    with user_errors():
        trust(options.trust)
        description = read_setup(options.setup)
        names = _checked_nodes(options.nodes, description.setup.scenario.nodes)
        place = place_of(names, options.connect, options.keys, options.peer_timeout)
    job = Job(description.setup, description.run, "", None, description.tempo, place)

    def on_event(happened: Happened) -> None:
        if happened.what == "started":
            sys.stderr.write(f"run {description.run}: nodes {' '.join(names)} look for it\n")
        elif happened.what == "ended":
            sys.stderr.write(f"{happened.detail}; the others go on\n")

    take_part(job, None, on_event)


def _checked_nodes(nodes: tuple[int, ...], count: int) -> list[str]:
    if not nodes:
        raise ValueError("no node is named; say which nodes run on this host, such as 0 1")
    for number in nodes:
        if not 0 <= number < count:
            raise ValueError(f"node {number}: the network has nodes 0 to {count - 1}")
    if len(set(nodes)) < len(nodes):
        raise ValueError(f"nodes {' '.join(map(str, nodes))}: one is named twice; name each once")
    return list(map(str, nodes))


@dataclass(frozen=True, kw_only=True)
class UpOptions:
    """The hosts, and the form of the results."""

    hosts: tyro.conf.Positional[Path]
    """File that says which host runs which nodes (docs/deployment.md)."""
    json: bool = False
    """Print one JSON object instead of a table."""


def up(options: Annotated[UpOptions, tyro.conf.arg(name="")]) -> None:
    """Start a network on several hosts over ssh; show its log; end it."""
    from concord.features.hosts.plan import read_plan
    from concord.features.hosts.up import NetworkOverSsh, announcement

    with user_errors():
        plan = read_plan(options.hosts)
    sys.stderr.write(announcement(plan) + "\n")
    with NetworkOverSsh(plan, _log) as network:
        with user_errors():
            network.start_routers()
        code = network.run(*(("--json",) if options.json else ()))
    sys.exit(code)


def _log(line: str) -> None:
    sys.stderr.write(line + "\n")
    sys.stderr.flush()
