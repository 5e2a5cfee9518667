"""Folder of a run's results, with run.json, run.mcap, run.nc and bus.pcap."""

import platform
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from concord._version import __version__
from concord.filters.metrics import consensus
from concord.nodes.tempo import Tempo
from concord.results.bus.bus_report import times_of
from concord.results.innovations.of_run import (
    RunInnovations,
    innovation_variables,
    run_innovations,
)
from concord.results.places import new_name
from concord.results.records.extras import run_extras
from concord.results.records.netcdf_file import DESCRIPTION, RECORDING, write_dataset
from concord.results.records.record_spread import record_ages
from concord.results.records.trace import Trace
from concord.runtime.json_file import read_json, write_json
from concord.scenarios.catalogue import definition_of, scored_nees
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    import xarray

import shutil

from concord.disk import writing
from concord.results.records.netcdf_file import ARRAYS, optional_variables, state_coordinates
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.option import Choice
from concord.scenarios.types.schedules import arbiter_of
from concord.scenarios.user.values import (
    FromFile,
    ValueSource,
    file_of,
    is_source_name,
    source_of,
)

_FIELDS = ("plant", "rule", "bus", "filter")


def keep_copies(folder: Path, scenario: Scenario) -> None:
    """Copy the user's files of a scenario into the folder of its run."""
    for source in _sources(scenario):
        copy = _copy(folder, source)
        with writing(copy):
            shutil.copyfile(file_of(source), copy)


def from_copies(folder: Path, scenario: Scenario) -> Scenario:
    """The scenario with the copies in the folder of its run, where there are some."""
    changed = {}
    for field in _FIELDS:
        choice: Choice = getattr(scenario, field)
        if isinstance(choice, FromFile) and _copy(folder, choice.where).is_file():
            name = choice.source.rpartition(":")[2]
            copied = f"{_copy(folder, choice.where)}:{name}"
            changed[field] = msgspec.structs.replace(choice, source=copied)
    scenario = msgspec.structs.replace(scenario, **changed)
    arbiter = arbiter_of(scenario.bus.schedule)
    if is_source_name(arbiter) and _copy(folder, source_of(arbiter)).is_file():
        name, digest = arbiter.rpartition(":")[2].split("#")
        copied = f"{_copy(folder, source_of(arbiter))}:{name}#{digest}"
        return scenario.with_(arbiter=copied)
    return scenario


def _sources(scenario: Scenario) -> list[ValueSource]:
    choices = [getattr(scenario, field) for field in _FIELDS]
    found = [one.where for one in choices if isinstance(one, FromFile)]
    arbiter = arbiter_of(scenario.bus.schedule)
    found += [source_of(arbiter)] if is_source_name(arbiter) else []
    return [source for source in found if source.digest]


def _copy(folder: Path, source: ValueSource) -> Path:
    stem = source.name.rpartition(":")[0].removesuffix(".py").replace("/", ".").rpartition(".")[2]
    return folder / f"{stem}-{source.digest}.py"


BATCHED = "batched"
"""The driver whose folder holds many runs and no recording."""
NODE_CAPTURE = "bus_node_{}.pcap"
_VERSIONED = ("numpy", "scipy", "networkx", "eclipse-zenoh", "msgspec")


class Description(msgspec.Struct, frozen=True):
    """Description of a run and its versions, enough to repeat it; `tempo` only in real time."""

    run: str
    driver: str
    seed: int
    setup: Setup
    versions: dict[str, str]
    commit: str | None
    tempo: Tempo | None = None


def new_folder(out: Path | None, scenario: str) -> tuple[str, Path]:
    """A unique name for a run and its folder, which is made: `out`, or one below runs/.

    Raises:
        ValueError: `out` exists, or cannot be made.
    """
    run = new_name(scenario)
    return run, make_folder(out, run)


def make_folder(out: Path | None, run: str) -> Path:
    """Make the folder of a run: `out`, or one of its name below runs/.

    Raises:
        ValueError: `out` exists, or cannot be made.
    """
    folder = out if out is not None else Path("runs") / run
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise ValueError(
            f"--out {folder}: the folder exists and a run is never written over; "
            "choose another name or remove it"
        ) from None
    except OSError as error:
        raise ValueError(
            f"--out {folder}: cannot be made ({error.strerror}); choose another place"
        ) from None
    return folder


def describe(run: str, driver: str, setup: Setup, tempo: Tempo | None = None) -> Description:
    """Return the description of a run by this version of the program."""
    return Description(run, driver, setup.scenario.seed, setup, versions(), commit(), tempo)


def versions(*others: str) -> dict[str, str]:
    """Return the versions of this program, of Python, of the libraries that affect its numbers, and
    of `others`."""
    found = {name: version(name) for name in (*_VERSIONED, *others)}
    return {"concord": __version__, **found, "python": platform.python_version()}


def commit() -> str | None:
    """Return the commit of the program's own checkout, or None for an installed one."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    try:
        found = subprocess.check_output(
            ["git", "-C", str(root), "rev-parse", "HEAD"], text=True, stderr=subprocess.DEVNULL
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return found.strip() or None


def provenance() -> dict[str, str]:
    """Return versions and commit as attributes of a data set."""
    text = msgspec.json.encode(versions()).decode()
    return {"versions": text, "commit": commit() or "unknown"}


def write_description(folder: Path, description: Description) -> None:
    """Write run.json, and beside it the files of an own plant or rule."""
    keep_copies(folder, description.setup.scenario)
    write_json(folder / DESCRIPTION, description)


def read_description(folder: Path) -> Description:
    """Read run.json.

    Raises:
        ValueError: there is none, or it is not one of ours.
    """
    found = read_description_file(folder / DESCRIPTION)
    scenario = from_copies(folder, found.setup.scenario)
    setup = msgspec.structs.replace(found.setup, scenario=scenario)
    return msgspec.structs.replace(found, setup=setup)


def read_description_file(path: Path) -> Description:
    """Read what run.json holds from a file of any name.

    Raises:
        ValueError: there is none, or it is not one of ours.
    """
    cure = "name a run folder, or for a host the file that `concord setup` has made"
    return read_json(path, Description, cure, "not the description of a run")


def recording_of(folder: Path) -> Path:
    """Return the recording of a run's messages.

    Raises:
        ValueError: there is no such folder, or it holds none.
    """
    if not folder.exists():
        raise ValueError(f"{folder} does not exist; name the folder of a run")
    recording = folder / RECORDING
    if not recording.is_file():
        raise ValueError(
            f"{folder}: it holds no {RECORDING}; name the folder of a run that recorded its "
            "messages (--driver in-process, processes or realtime)"
        )
    return recording


def write_arrays(
    folder: Path,
    description: Description,
    trace: Trace,
    innovations: RunInnovations | None = None,
) -> None:
    """Write run.nc: the trace with named dimensions and units, errors, NEES and innovations.

    `innovations` are computed where they are not given.
    """
    # Loading xarray can take longer than a run, so it is loaded only to write a file.
    import xarray

    setup = description.setup
    definition = definition_of(setup.scenario)
    names = definition.plant(setup.scenario).state_names
    truth = trace.truth[:, None, :]
    state = ("step", "node", "state")
    score = list(definition.score.nees_states)
    errors = trace.mean - truth
    variables: dict[str, Any] = {
        "truth": (("step", "state"), trace.truth),
        "mean": (state, trace.mean),
        "cov": ((*state, "other_state"), trace.cov),
        "error": (state, errors),
        "nees": (
            ("step", "node"),
            scored_nees(setup.scenario, errors, trace.cov),
            {"states": [names[i] for i in score], **_meaning(setup)},
        ),
        "disagreement": (state, trace.mean - consensus(trace.mean)),
        "readings": (("step", "node", "reading", "channel"), trace.readings),
        "published": (("step", "round", "node"), trace.published.astype(np.int8)),
        "ages": (("step", "node", "neighbour"), trace.ages, {"units": "communication cycles"}),
        "missed": (("node",), np.array([c.get("missed", 0) for c in trace.counters])),
    }
    if trace.spread is not None:
        ages = record_ages(trace.spread).swapaxes(0, 1)
        variables["record_age"] = (("step", "node", "source"), ages, {"units": "steps"})
    if (extras := run_extras(setup.scenario)) is not None:
        variables |= extras.variables(setup, trace.extra, trace.readings)
    if trace.estimate_age_s is not None:
        limit = {} if description.tempo is None else {"limit": description.tempo.oldest_s}
        said = {"units": "s", "origin": "sampling instant of the step", **limit}
        variables["estimate_age"] = (("step", "node"), trace.estimate_age_s, said)
    if trace.duality_gap is not None:
        said = {"meaning": "the trace of the set is within this fraction of the least"}
        variables["duality_gap"] = (("step", "node"), trace.duality_gap, said)
    if (found := innovations or run_innovations(setup, trace)) is not None:
        variables |= innovation_variables(setup, found)
    variables |= _bus_variables(setup, trace)
    variables |= optional_variables(("step",), trace.control, trace.suspect, trace.past)
    coordinates = state_coordinates(setup, trace.steps)
    write_whole(folder, xarray.Dataset(variables, coordinates), description)


def write_whole(folder: Path, dataset: "xarray.Dataset", description: Description) -> None:
    """Write run.nc with what was run, or leave none."""
    dataset = dataset.assign_attrs(
        title=f"concord run {description.run}",
        scenario=msgspec.json.encode(description.setup.scenario).decode(),
        driver=description.driver,
        seed=description.setup.scenario.seed,
        versions=msgspec.json.encode(description.versions).decode(),
        commit=description.commit or "unknown",
    )
    write_dataset(dataset, folder / ARRAYS)


def _meaning(setup: Setup) -> dict[str, str]:
    """Return the meanings of cov and nees for set-valued estimates."""
    if not is_set_valued(setup.scenario):
        return {}
    return {"meaning": "cov is the shape matrix P of a set e' P^-1 e <= 1 that holds the truth"}


def _bus_variables(setup: Setup, trace: Trace) -> dict[str, Any]:
    """Times on the bus as variables; none where the bus has no time."""
    times = times_of(setup, trace)
    if times is None:
        return {}
    per_share = ("step", "round", "node")
    in_cycle = {"units": "us", "origin": "beginning of the communication cycle"}
    return {
        "asked": (per_share, trace.asked.astype(np.int8)),
        "bus_cycle": (
            ("step", "round"),
            times.bus_cycle,
            {"units": "1", "origin": "beginning of the run"},
        ),
        "bus_load": (("step", "round"), times.load, {"units": "1"}),
        "delay_us": (("step",), times.delay_us, {"units": "us"}),
        "share_start_us": (per_share, times.share_start_us, in_cycle),
        "share_end_us": (per_share, times.share_end_us, in_cycle),
    }
