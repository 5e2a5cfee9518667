"""Checks of `concord doctor`, one function for each subject."""

import importlib.util
import os
import platform
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from concord.experiments.doctor import machine
from concord.experiments.doctor.finding import Finding, Verdict
from concord.features.recorded import intel_lab, mrclam_files
from concord.features.recorded.scenario import DATA_VARIABLE as MRCLAM_VARIABLE
from concord.features.vehicle.plant import drive_log
from concord.runtime.network.links import ZenohEndpoints
from concord.runtime.network.sockets import in_folder, socket_folder
from concord.runtime.network.zenoh_transport import LinkError, Transport

PAGE_PORT = 8080
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


def look(nodes: int, data: Sequence[Path]) -> Iterator[Finding]:
    """Everything, one finding at a time: for a network of `nodes`, and these folders of data."""
    yield Finding("python", Verdict.OK, f"{platform.python_version()} on {platform.machine()}")
    yield machine.sockets()
    yield machine.files(nodes)
    yield zenoh(round_trip_s)
    yield machine.memory(nodes, machine.available_memory_mb())
    yield machine.blas(os.environ, os.cpu_count())
    yield machine.clock(machine.measured_lateness_s(), datetime.now(UTC).year)
    yield machine.disk(Path.cwd())
    yield browser(shutil.which)
    yield machine.page_port(PAGE_PORT)
    for folder in (*data, *folders_of(os.environ)):
        yield data_folder(folder)
    for name in EXTRAS:
        yield extra(name)


def zenoh(measure: Callable[[], float]) -> Finding:
    """Return whether two sessions hear each other over a unix socket."""
    try:
        seconds = measure()
    except (LinkError, TimeoutError, ValueError) as error:
        cure = "allow unix sockets between processes, or look at the sandbox"
        return Finding("zenoh", Verdict.FAILING, str(error), cure)
    return Finding("zenoh", Verdict.OK, f"there and back in {seconds * 1e6:.0f} µs")


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


def browser(which: Callable[[str], str | None]) -> Finding:
    """Return whether the dashboard can be looked at on this machine."""
    found = next((path for name in _BROWSERS if (path := which(name))), None)
    if found is None:
        cure = "install one, or look from another machine: ssh -L 8080:localhost:8080 THIS-ONE"
        return Finding("browser", Verdict.WARNING, "none here for the dashboard", cure)
    return Finding("browser", Verdict.OK, found)


def folders_of(environment: Mapping[str, str]) -> list[Path]:
    """Return the folders of data that the environment names."""
    variables = (MRCLAM_VARIABLE, intel_lab.DATA_VARIABLE)
    return [Path(environment[name]) for name in variables if environment.get(name)]


def data_folder(folder: Path) -> Finding:
    """Check a folder of recorded data, and read it to the end."""
    readers = (
        ("Barcodes.dat", "a MRCLAM recording", mrclam_files.read_recording),
        (intel_lab.LOCATIONS, "the Intel lab", intel_lab.intel_lab),
        (drive_log.COLUMNS, "a drive", drive_log.read_folder),
    )
    name = f"data {folder}"
    for mark, what, read in readers:
        if (folder / mark).is_file():
            return _read(name, what, partial(read, folder))
    marks = ", ".join(mark for mark, _, _ in readers)
    seen = "no known data there" if folder.is_dir() else "no such folder"
    return Finding(name, Verdict.FAILING, seen, f"name a folder that holds one of {marks}")


def _read(name: str, what: str, read: Callable[[], object]) -> Finding:
    try:
        read()
    except (ValueError, OSError) as error:
        return Finding(name, Verdict.FAILING, str(error), f"fetch {what} again")
    return Finding(name, Verdict.OK, what)


def extra(name: str) -> Finding:
    """Return whether an optional part is installed."""
    module, purpose = EXTRAS[name]
    if importlib.util.find_spec(module) is None:
        cure = f"if you want {purpose}: `make extras`, or `pip install '.[{name}]'` in a checkout"
        return Finding(f"extra {name}", Verdict.OPTIONAL, "not installed", cure)
    return Finding(f"extra {name}", Verdict.OK, f"installed: {purpose}")
