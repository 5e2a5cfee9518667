"""Checks of the machine by `concord doctor`: memory, ports, files, threads, clock, disk."""

import os
import resource
import shutil
import socket
import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from concord.experiments.doctor.finding import Finding, Verdict
from concord.runtime.network.links import LOOPBACK
from concord.runtime.network.sockets import socket_folder

# An allowance for environment, recorder, router, launcher process and launcher with their
# libraries, and for each node: a forked one was measured at 4 to 12 MB with its share of
# the common pages.
BASE_MB, NODE_MB = 400, 15
_FILES_PER_PROCESS, _FILES_BASE = 4, 256
_LATE_S = 0.002
_DISK_MB = 500
_BLAS_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
_FIRST_YEAR = 2025


def memory(nodes: int, available_mb: float | None) -> Finding:
    """Return whether `nodes` processes fit into what is free."""
    need = BASE_MB + NODE_MB * nodes
    if available_mb is None:
        said = f"{nodes} nodes need about {need} MB; this system does not say what is free"
        return Finding("memory", Verdict.WARNING, said, "look at its own monitor before you start")
    said = f"{nodes} nodes need about {need} MB, {available_mb:.0f} MB are free"
    if need > available_mb:
        fit = max(0, int((available_mb - BASE_MB) // NODE_MB))
        cure = f"close something, take at most {fit} nodes, or the in-process driver"
        return Finding("memory", Verdict.FAILING, said, cure)
    if need > available_mb / 2:
        return Finding("memory", Verdict.WARNING, said, "close what you do not need")
    return Finding("memory", Verdict.OK, said)


def available_memory_mb(
    proc: Path = Path("/proc"), group: Path = Path("/sys/fs/cgroup")
) -> float | None:
    """Free memory as the kernel counts it, or what is left to this container if that is less."""
    try:
        lines = (proc / "meminfo").read_text().splitlines()
        fields = dict(line.split(":", 1) for line in lines if ":" in line)
        free = int(fields["MemAvailable"].split()[0]) / 1024
    except (OSError, KeyError, ValueError):
        return None
    try:
        limit = int((group / "memory.max").read_text())
        used = int((group / "memory.current").read_text())
    except (OSError, ValueError):
        # No such group, or the word max.
        return free
    return min(free, (limit - used) / 1024**2)


def sockets() -> Finding:
    """Return whether a network finds a folder of its own for its unix sockets."""
    try:
        with socket_folder() as folder:
            said = f"in a folder of {Path(folder).parent} that no other user can open"
    except ValueError as error:
        return Finding("sockets", Verdict.FAILING, str(error), "set TMPDIR")
    return Finding("sockets", Verdict.OK, said)


def page_port(port: int) -> Finding:
    """Return whether the dashboard's usual port is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            said = f"port {port} of the dashboard is in use"
            cure = "nothing to do, the next free one is taken; or choose one with --http-port"
            return Finding("page", Verdict.WARNING, said, cure)
    return Finding("page", Verdict.OK, f"port {port} of the dashboard is free")


def files(nodes: int, limit: int | None = None) -> Finding:
    """Return whether the launcher may open what it needs for `nodes` nodes."""
    if limit is None:
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    need = _FILES_BASE + _FILES_PER_PROCESS * nodes
    if limit == resource.RLIM_INFINITY or limit >= need:
        return Finding(
            "files", Verdict.OK, f"a process may open {_words(limit)}, {need} are enough"
        )
    said = f"a process may open {limit} files, {nodes} nodes may need {need}"
    return Finding("files", Verdict.FAILING, said, f"ulimit -n {need}")


def _words(limit: int) -> str:
    return "any number of files" if limit == resource.RLIM_INFINITY else f"{limit} files"


def blas(environment: Mapping[str, str], cores: int | None) -> Finding:
    """Whether each process computes with one thread, as repeatable sums and many nodes want it."""
    said = {name: environment[name] for name in _BLAS_VARIABLES if name in environment}
    more = [f"{name}={value}" for name, value in said.items() if value != "1"]
    if more:
        cure = f"unset {' '.join(one.partition('=')[0] for one in more)}: one thread is the default"
        return Finding("threads", Verdict.WARNING, f"linear algebra has {', '.join(more)}", cure)
    here = "an unknown number of" if cores is None else str(cores)
    return Finding("threads", Verdict.OK, f"linear algebra takes one per process, {here} cores")


def clock(lateness_s: Sequence[float], year: int) -> Finding:
    """How late this machine wakes up, and whether its date can be right."""
    if year < _FIRST_YEAR:
        said = f"the clock says it is {year}"
        return Finding(
            "clock", Verdict.FAILING, said, "set it: certificates are checked against it"
        )
    late = statistics.median(lateness_s)
    said = f"wakes up {late * 1e3:.2f} ms late (median), {max(lateness_s) * 1e3:.1f} ms at most"
    if late > _LATE_S:
        cure = "end what else computes, or stretch time; lockstep runs do not mind"
        return Finding("clock", Verdict.WARNING, said, cure)
    return Finding("clock", Verdict.OK, said)


def measured_lateness_s(sleeps: int = 30, asleep_s: float = 0.001) -> list[float]:
    """How much longer than asked each of some short sleeps takes, in seconds."""
    late = []
    for _ in range(sleeps):
        began = time.perf_counter()
        time.sleep(asleep_s)
        late.append(time.perf_counter() - began - asleep_s)
    return late


def disk(folder: Path) -> Finding:
    """Return whether recordings can be written here."""
    if not os.access(folder, os.W_OK):
        said = f"{folder} cannot be written to"
        return Finding("disk", Verdict.FAILING, said, "start in another folder, or name one: --out")
    free = shutil.disk_usage(folder).free / 1e6
    if free < _DISK_MB:
        said = f"{free:.0f} MB are free in {folder}"
        return Finding("disk", Verdict.WARNING, said, "long runs record more; make room")
    return Finding("disk", Verdict.OK, f"{free / 1e3:.1f} GB are free in {folder}")
