"""`concord doctor`: whether this machine can run a network, and what to do where it cannot."""

import importlib.util
import os
import platform
import resource
import shutil
import statistics
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from rich.console import Console

from concord.experiments.user_errors import user_errors
from concord.runtime.network.links import ZenohEndpoints
from concord.runtime.network.sockets import in_folder, socket_folder
from concord.runtime.network.zenoh_transport import LinkError, Transport
from concord.studies.memory import available_memory_mb, files_needed

_BROWSERS = ("firefox", "chromium", "chromium-browser", "google-chrome", "microsoft-edge", "safari")
_ROUND_TRIPS = 50
_ANSWER_S = 5.0
# The module that tells whether an extra is there, and what it is for.
EXTRAS = {
    "convex": ("cvxpy", "the tight bounds of set-membership filters"),
    "dask": ("distributed", "sweeps over Dask"),
    "logs": ("pyulog", "logs in MCAP and ULog files"),
    "secure": ("cryptography", "concord keys"),
    "vehicle": ("vehiclemodels", "the simulated cars"),
}
# An allowance for environment, recorder, router, launcher process and launcher with their
# libraries, and for each node: a forked one was measured at 4 to 12 MB with its share of
# the common pages.
BASE_MB, NODE_MB = 400, 15
_LATE_S = 0.002
_DISK_MB = 500
_BLAS_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
_FIRST_YEAR = 2025


class Verdict(Enum):
    """How something stands: only a failure keeps a network from running."""

    OK = "ok"
    OPTIONAL = "optional"
    WARNING = "warning"
    FAILING = "failing"


class Looked(msgspec.Struct, frozen=True):
    """Looked: subject, status, observation, and remedy (empty if none is needed)."""

    subject: str
    verdict: Verdict
    seen: str
    cure: str = ""


_STYLES = {
    Verdict.OK: "green",
    Verdict.OPTIONAL: "dim",
    Verdict.WARNING: "yellow",
    Verdict.FAILING: "bold red",
}


@dataclass(frozen=True)
class DoctorOptions:
    """Intended use of the machine."""

    nodes: int = 16
    """Number of sensor nodes of the network you have in mind."""
    json: bool = False
    """Print one JSON object."""


def doctor(options: Annotated[DoctorOptions, tyro.conf.arg(name="")]) -> None:
    """Look whether this machine can run a network; exit code 1 if something is failing."""
    with user_errors():
        if options.nodes < 1:
            raise ValueError(f"--nodes {options.nodes}: a network has at least one node")
    findings = []
    for finding in look(options.nodes):
        findings.append(finding)
        if not options.json:
            _show(finding)
    healthy = all(finding.verdict is not Verdict.FAILING for finding in findings)
    if options.json:
        result = {"healthy": healthy, "findings": findings}
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
    sys.exit(0 if healthy else 1)


def _show(finding: Looked) -> None:
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{finding.verdict.value:8}", style=_STYLES[finding.verdict], end="")
    console.print(f"{finding.subject}: {finding.seen}", markup=False)
    if finding.cure:
        console.print(f"        -> {finding.cure}", markup=False)


def look(nodes: int) -> Iterator[Looked]:
    """Yield every finding for a network of `nodes`."""
    yield Looked("python", Verdict.OK, f"{platform.python_version()} on {platform.machine()}")
    yield sockets()
    yield files(nodes)
    yield zenoh(round_trip_s)
    yield memory(nodes, available_memory_mb())
    yield blas(os.environ, os.cpu_count())
    yield clock(measured_lateness_s(), datetime.now(UTC).year)
    yield disk(Path.cwd())
    yield browser(shutil.which)
    for name in EXTRAS:
        yield extra(name)


def zenoh(measure: Callable[[], float]) -> Looked:
    """Return whether two sessions hear each other over a unix socket."""
    try:
        seconds = measure()
    except (LinkError, TimeoutError, ValueError) as error:
        cure = "allow unix sockets between processes, or look at the sandbox"
        return Looked("zenoh", Verdict.FAILING, str(error), cure)
    return Looked("zenoh", Verdict.OK, f"there and back in {seconds * 1e6:.0f} µs")


def round_trip_s() -> float:
    """Return the median seconds of a message there and back over a unix socket of its own folder.

    Raises:
        LinkError: a session cannot be opened.
        TimeoutError: nothing comes back.
        ValueError: no folder takes a socket.
    """
    with socket_folder() as folder:
        return _round_trip_s(in_folder(folder, ["doctor"])["doctor"])


def _round_trip_s(endpoint: str) -> float:
    """Median seconds of a message there and back between two sessions.

    Raises:
        LinkError: a session cannot be opened.
        TimeoutError: nothing comes back.
    """
    times: list[float] = []
    echo = Transport("doctor", ZenohEndpoints("peer", (endpoint,), ()), ["there"], 8)
    caller = Transport("doctor", ZenohEndpoints("peer", (), (endpoint,), _ANSWER_S), ["back"], 8)

    def answer() -> None:
        for _ in range(_ROUND_TRIPS):
            echo.receive("there")
            echo.send("back", b"!")

    def call() -> None:
        join = threading.Thread(target=echo.join, args=("echo", {"caller"}), daemon=True)
        join.start()
        caller.join("caller", {"echo"})
        join.join()
        threading.Thread(target=answer, daemon=True).start()
        for _ in range(_ROUND_TRIPS):
            began = time.perf_counter()
            caller.send("there", b"?")
            caller.receive("back")
            times.append(time.perf_counter() - began)

    calling = threading.Thread(target=call, daemon=True)
    calling.start()
    calling.join(_ANSWER_S)
    if calling.is_alive():
        raise TimeoutError(f"nothing comes back from {endpoint} in {_ANSWER_S:g} s")
    caller.close()
    echo.close()
    return sorted(times)[len(times) // 2]


def browser(which: Callable[[str], str | None]) -> Looked:
    """Return whether the dashboard can be looked at on this"""
    found = next((path for name in _BROWSERS if (path := which(name))), None)
    if found is None:
        cure = "install one, or look from another machine: ssh -L 8080:localhost:8080 THIS-ONE"
        return Looked("browser", Verdict.WARNING, "none here for the dashboard", cure)
    return Looked("browser", Verdict.OK, found)


def extra(name: str) -> Looked:
    """Return whether an optional part is installed."""
    module, purpose = EXTRAS[name]
    if importlib.util.find_spec(module) is None:
        cure = f"if you want {purpose}: `make extras`, or `pip install '.[{name}]'` in a checkout"
        return Looked(f"extra {name}", Verdict.OPTIONAL, "not installed", cure)
    return Looked(f"extra {name}", Verdict.OK, f"installed: {purpose}")


def memory(nodes: int, available_mb: float | None) -> Looked:
    """Return whether `nodes` processes fit into what is free."""
    need = BASE_MB + NODE_MB * nodes
    if available_mb is None:
        said = f"{nodes} nodes need about {need} MB; this system does not say what is free"
        return Looked("memory", Verdict.WARNING, said, "look at its own monitor before you start")
    said = f"{nodes} nodes need about {need} MB, {available_mb:.0f} MB are free"
    if need > available_mb:
        fit = max(0, int((available_mb - BASE_MB) // NODE_MB))
        cure = f"close something, take at most {fit} nodes, or the in-process driver"
        return Looked("memory", Verdict.FAILING, said, cure)
    if need > available_mb / 2:
        return Looked("memory", Verdict.WARNING, said, "close what you do not need")
    return Looked("memory", Verdict.OK, said)


def sockets() -> Looked:
    """Return whether a network finds a folder of its own for its unix sockets."""
    try:
        with socket_folder() as folder:
            said = f"in a folder of {Path(folder).parent} that no other user can open"
    except ValueError as error:
        return Looked("sockets", Verdict.FAILING, str(error), "set TMPDIR")
    return Looked("sockets", Verdict.OK, said)


def files(nodes: int, limit: int | None = None) -> Looked:
    """Return whether the launcher may open what it needs for `nodes` nodes."""
    if limit is None:
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    need = files_needed(nodes)
    if limit == resource.RLIM_INFINITY or limit >= need:
        return Looked("files", Verdict.OK, f"a process may open {_words(limit)}, {need} are enough")
    said = f"a process may open {limit} files, {nodes} nodes may need {need}"
    return Looked("files", Verdict.FAILING, said, f"ulimit -n {need}")


def _words(limit: int) -> str:
    return "any number of files" if limit == resource.RLIM_INFINITY else f"{limit} files"


def blas(environment: Mapping[str, str], cores: int | None) -> Looked:
    """Whether each process computes with one thread, as repeatable sums and many nodes want it."""
    said = {name: environment[name] for name in _BLAS_VARIABLES if name in environment}
    more = [f"{name}={value}" for name, value in said.items() if value != "1"]
    if more:
        cure = f"unset {' '.join(one.partition('=')[0] for one in more)}: one thread is the default"
        return Looked("threads", Verdict.WARNING, f"linear algebra has {', '.join(more)}", cure)
    here = "an unknown number of" if cores is None else str(cores)
    return Looked("threads", Verdict.OK, f"linear algebra takes one per process, {here} cores")


def clock(lateness_s: Sequence[float], year: int) -> Looked:
    """How late this machine wakes up, and whether its date can be right."""
    if year < _FIRST_YEAR:
        said = f"the clock says it is {year}"
        return Looked("clock", Verdict.FAILING, said, "set it: certificates are checked against it")
    late = statistics.median(lateness_s)
    said = f"wakes up {late * 1e3:.2f} ms late (median), {max(lateness_s) * 1e3:.1f} ms at most"
    if late > _LATE_S:
        cure = "end what else computes, or stretch time; lockstep runs do not mind"
        return Looked("clock", Verdict.WARNING, said, cure)
    return Looked("clock", Verdict.OK, said)


def measured_lateness_s(sleeps: int = 30, asleep_s: float = 0.001) -> list[float]:
    """How much longer than asked each of some short sleeps takes, in seconds."""
    late = []
    for _ in range(sleeps):
        began = time.perf_counter()
        time.sleep(asleep_s)
        late.append(time.perf_counter() - began - asleep_s)
    return late


def disk(folder: Path) -> Looked:
    """Return whether recordings can be written here."""
    if not os.access(folder, os.W_OK):
        said = f"{folder} cannot be written to"
        return Looked("disk", Verdict.FAILING, said, "start in another folder, or name one: --out")
    free = shutil.disk_usage(folder).free / 1e6
    if free < _DISK_MB:
        said = f"{free:.0f} MB are free in {folder}"
        return Looked("disk", Verdict.WARNING, said, "long runs record more; make room")
    return Looked("disk", Verdict.OK, f"{free / 1e3:.1f} GB are free in {folder}")
