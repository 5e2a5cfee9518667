"""Common code of the commands for networks on several hosts: setup file, keys, end of the run."""

from collections.abc import Callable, Sequence
from pathlib import Path

from concord.experiments.user_errors import user_errors
from concord.results.folder import Description, read_description_file
from concord.runtime.network.links import checked_endpoints, checked_run, key_file
from concord.runtime.processes.job import Happened, HostPlace, Job
from concord.runtime.processes.launcher import run_job
from concord.scenarios.user.trust import require_known


def key_files(folder: Path | None, names: Sequence[str]) -> dict[str, str]:
    """Return the file of `concord keys` of each process, by name; none where there is no folder.

    Raises:
        ValueError: a file is missing, or other users have access to it.
    """
    if folder is None:
        return {}
    return {
        name: key_file(
            folder / f"{_certificate(name)}.json",
            f"{_in_words(name)} needs it; copy it from the folder that `concord keys` made",
        )
        for name in names
    }


def _certificate(name: str) -> str:
    return f"node-{name}" if name.isdecimal() else name


def _in_words(name: str) -> str:
    return f"node {name}" if name.isdecimal() else f"the {name}"


def read_setup(path: Path) -> Description:
    """Read the file that `concord setup` has written, or the run.json of a run.

    Raises:
        ValueError: the file cannot be read, or is no setup.
    """
    description = read_description_file(path)
    require_known(description.setup.scenario, path)
    checked_run(description.run)
    return description


def place_of(
    cast: Sequence[str], connect: Sequence[str], keys: Path | None, peer_timeout_s: float = 60.0
) -> HostPlace:
    """Return the part of a network that is to be on this host.

    Raises:
        ValueError: endpoints or keys that cannot be.
    """
    if not peer_timeout_s > 0:
        raise ValueError(f"--peer-timeout {peer_timeout_s:g}: must be above 0 seconds")
    endpoints = checked_endpoints("--connect", connect, keys is not None)
    return HostPlace(list(cast), list(endpoints), key_files(keys, cast), peer_timeout_s)


def take_part(job: Job, folder: Path | None, on_event: Callable[[Happened], None]) -> None:
    """Run the processes of this host until the end of the network.

    Raises:
        NetworkFailed: the network breaks.
    """
    with user_errors():
        run_job(job, folder, on_event)
