"""Folder of a run's results, with run.json, run.mcap, run.nc and bus.pcap."""

import platform
import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path

import msgspec

from concord._version import __version__
from concord.disk import writing
from concord.nodes.tempo import Tempo
from concord.results.places import new_name
from concord.results.records.netcdf_file import ARRAYS, DESCRIPTION, RECORDING, Arrays, write_arrays
from concord.results.verdict.findings import VerdictOnRuns
from concord.runtime.json_file import read_json, write_json
from concord.runtime.recording import origin_of
from concord.scenarios.catalogue import set_received
from concord.scenarios.received import States, receive, states_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.option import Choice
from concord.scenarios.types.plants import UserPlant
from concord.scenarios.types.schedules import arbiter_of
from concord.scenarios.user.trust import UnknownCode, require_known
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
WITHOUT_CODE = (
    "note: the code of the plant is not loaded, so figures of one filter with all readings, of "
    "nodes alone and of innovations are unknown; if it may run here, add --trust {folder}\n"
)
NODE_CAPTURE = "bus_node_{}.pcap"
_VERSIONED = ("numpy", "scipy", "networkx", "eclipse-zenoh", "msgspec")


class Description(msgspec.Struct, frozen=True):
    """Description of a run and its versions, enough to repeat it; `tempo` only in real time.

    `verdict` is that of its figures; None before they were computed. `states` is all that a reader
    without the code of an own plant knows of it.
    """

    run: str
    driver: str
    seed: int
    setup: Setup
    versions: dict[str, str]
    commit: str | None
    tempo: Tempo | None = None
    verdict: VerdictOnRuns | None = None
    states: States | None = None


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
    states = states_of(setup.scenario)
    return Description(
        run, driver, setup.scenario.seed, setup, versions(), commit(), tempo, states=states
    )


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


def write_verdict(folder: Path, verdict: VerdictOnRuns) -> None:
    """Write the verdict into run.json."""
    description = read_description_file(folder / DESCRIPTION)
    write_json(folder / DESCRIPTION, msgspec.structs.replace(description, verdict=verdict))


def read_description(folder: Path) -> Description:
    """Read run.json.

    Raises:
        ValueError: there is none, it is not one of ours, or it names code or a file of this machine
            that no run of this user has named (`scenarios/user/trust.py`).
    """
    found = read_description_file(folder / DESCRIPTION)
    require_known(found.setup.scenario, folder)
    if isinstance(found.setup.scenario.plant, UserPlant):
        set_received(found.setup.scenario, None)
    scenario = from_copies(folder, found.setup.scenario)
    setup = msgspec.structs.replace(found.setup, scenario=scenario)
    return msgspec.structs.replace(found, setup=setup)


def read_shown(folder: Path) -> Description:
    """Read run.json to show its run: an own plant that is not known needs no code.

    Raises:
        ValueError: as `read_description`, of all code but that of the plant.
    """
    try:
        return read_description(folder)
    except UnknownCode as refusal:
        found = read_description_file(folder / DESCRIPTION)
        scenario, states = found.setup.scenario, found.states
        if states is None or not isinstance(scenario.plant, UserPlant):
            raise
        others = msgspec.to_builtins(scenario)
        for name in ("type", "source", "digest"):
            others["plant"].pop(name, None)
        require_known(others, folder)
        if len(states.names) != len(found.setup.prior_mean):
            raise ValueError(
                f"{folder / DESCRIPTION}: names {len(states.names)} states of "
                f"{len(found.setup.prior_mean)}; copy the folder again"
            ) from None
        receive(scenario, states, found.setup.time_step_s, refusal)
        return found


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


def write_whole(folder: Path, arrays: Arrays, description: Description) -> None:
    """Write run.nc with what was run, or leave none."""
    described = folder / DESCRIPTION
    asked = read_description_file(described) if described.is_file() else description
    attributes = dict(
        arrays.attributes,
        origin=msgspec.json.encode(origin_of(asked.setup, asked.run)).decode(),
        title=f"concord run {description.run}",
        driver=description.driver,
        seed=description.setup.scenario.seed,
        versions=msgspec.json.encode(description.versions).decode(),
        commit=description.commit or "unknown",
    )
    variables = dict(arrays.variables)
    if description.tempo is not None and "estimate_age_s" in variables:
        dimensions, values, told = variables["estimate_age_s"]
        told = told | {"limit": description.tempo.oldest_s}
        variables["estimate_age_s"] = dimensions, values, told
    write_arrays(Arrays(variables, arrays.coordinates, attributes), folder / ARRAYS)
