"""`concord dashboard` and `concord replay`: a network that runs, or a recorded run, in the browser.

A page attaches to a network and detaches from it unnoticed.
"""

import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from concord.experiments.other_runs import OtherRuns
from concord.experiments.page_options import PageOptions, check_place
from concord.experiments.page_process import (
    NETWORK_IS_GONE,
    NETWORK_RUNS,
    PORT,
    RUN_AGAIN,
    RUN_IS_OVER,
)
from concord.experiments.user_errors import user_errors
from concord.runtime.network.links import watcher_keys
from concord.runtime.network.network_file import read_network
from concord.studies.priority import give_way

if TYPE_CHECKING:
    from concord.dashboard.app import Dashboard
    from concord.dashboard.frames.live import LiveNetwork
    from concord.results.folder import Description

_LONGEST_WAIT_S = 60.0
_NICENESS = 10
_FIRST_STEPS_PER_S = 5.0


@dataclass(frozen=True, kw_only=True)
class AttachOptions:
    """Which network."""

    connect: tuple[str, ...] = ()
    """All endpoints of the network, as network.json in the run's folder names them."""
    folder: Path | None = None
    """The folder of the run, in place of its endpoints."""
    keys: Path | None = None
    """For tls/ endpoints: monitor.json of `concord keys` to look on, operator.json to command."""
    run: str | None = None
    """The name of the run; the only one that answers when left out."""
    read_only: bool = False
    """Show the network and take no commands: a page for spectators, with a view of its own."""
    with_launcher: bool = False
    """End when standard input closes, show the end of the run when standard input tells of it, and
    let the network go on once a browser looks: for the launcher of network and page."""


def dashboard(
    network: Annotated[AttachOptions, tyro.conf.arg(name="")],
    options: Annotated[PageOptions, tyro.conf.arg(name="")],
) -> None:
    """Watch and control a network that runs, in the browser."""
    with user_errors():
        check_place(options.host, options.http_port, options.public_name)
        connect, run = network.connect, network.run
        if network.folder is not None:
            there = read_network(network.folder)
            connect, run = tuple(there.connect), there.run
        if not connect:
            raise ValueError(
                "--connect: there is no endpoint; give those of network.json in the folder of the "
                "run, or --folder with that folder"
            )
        # The network comes first, on a machine that has too little for both.
        give_way(_NICENESS)
        from concord.dashboard.frames.live import LiveNetwork
        from concord.dashboard.serve import open_network

        source = LiveNetwork(connect, run, watcher_keys(network.keys, connect), network.read_only)
    others = OtherRuns(source.stage.setup, sparing=True)
    page = open_network(
        source, network.folder, options.host, options.http_port, options.light, others
    )
    if network.with_launcher:
        page.access.adopt(sys.stdin.readline().strip())
        _tell_launcher(PORT + f"{page.server.get_port()}\n".encode())
    sys.stderr.write(f"dashboard at {page.url}  (Ctrl-C leaves)\n")
    sys.stderr.flush()
    launcher_gone = threading.Event()
    if network.with_launcher:
        follow = threading.Thread(
            target=_follow_launcher, args=(page, source, network.folder, launcher_gone), daemon=True
        )
        follow.start()
        threading.Thread(target=_begin, args=(page,), daemon=True).start()
    try:
        page.run(launcher_gone.is_set)
    finally:
        others.close()
        page.close()


def _begin(page: "Dashboard") -> None:
    """Let the network go on, slowly enough to see it, once there is somebody to see it."""
    somebody = threading.Event()
    # Called for those who have come already, too.
    page.server.on_client_connect(lambda _: somebody.set())
    if somebody.wait(_LONGEST_WAIT_S):
        page.source.ask({"do": "speed", "steps_per_second": _FIRST_STEPS_PER_S})
    if page.source.ask({"do": "resume"}).accepted:
        _tell_launcher(NETWORK_RUNS)


def _tell_launcher(line: bytes) -> None:
    """Write a line to standard output, which the launcher reads; it may be gone."""
    with suppress(BrokenPipeError):
        sys.stdout.buffer.write(line)
        sys.stdout.buffer.flush()


def _follow_launcher(
    page: "Dashboard", source: "LiveNetwork", folder: Path | None, gone: threading.Event
) -> None:
    """Read what the launcher says: that the run is over, then, by closing, that it is gone."""
    for line in iter(sys.stdin.readline, ""):
        if line.encode() == RUN_IS_OVER:
            page.controls.offer_again(lambda: _tell_launcher(RUN_AGAIN))
            source.end("the run is over" if folder is None else f"results in {folder}")
        elif line.encode() == NETWORK_IS_GONE:
            step = source.pace().completed - 1
            source.end(f"network gone at step {step}; `concord collect {folder}` shows what came")
    gone.set()


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(PageOptions):
    """Where the page is, and whose code it may run."""

    trust: Path | None = None
    """Folder whose own code and files may be used here: results of another user."""


def replay(
    recording: tyro.conf.Positional[Path],
    options: Annotated[ReplayOptions, tyro.conf.arg(name="")],
    beside: tyro.conf.Positional[Path | None] = None,
) -> None:
    """Show a recorded run in the browser: its run.mcap or its folder; or the result of a sweep.

    A second run of the same scenario and seed is drawn beside it, and compared with it. A page of a
    sweep shows its cells, and computes and opens the runs that its viewers press.
    """
    # The page of a network does without them.
    from concord.results.records.netcdf_file import ARRAYS
    from concord.scenarios.user.trust import trust

    with user_errors():
        trust(options.trust)
    if recording.suffix == ".nc" and recording.name != ARRAYS:
        _explore(recording, options, beside)
        return
    from concord.dashboard.serve import open_recording, other_run
    from concord.results.figures.intervals import ratio_t
    from concord.results.folder import WITHOUT_CODE
    from concord.scenarios.catalogue import is_received

    with user_errors():
        check_place(options.host, options.http_port, options.public_name)
        description, file = _recorded(recording)
        setup, found = description.setup, description.verdict
        verdict = "" if found is None else found.in_words()
        other = None
        if beside is not None:
            labels = (recording.name, beside.name)
            if labels[0] == labels[1]:
                labels = (str(recording), str(beside))
            description_beside, file_beside = _recorded(beside)
            other = other_run(description_beside.setup, file_beside, setup, labels, ratio_t)
        others = OtherRuns(setup, sparing=False)
        page = open_recording(
            setup, file, options.host, options.http_port, options.light, others, other, verdict
        )
    if is_received(setup.scenario):
        sys.stderr.write(WITHOUT_CODE.format(folder=file.parent))
    sys.stderr.write(f"{page.url}  (Ctrl-C ends)\n")
    try:
        with user_errors():
            page.run(lambda: False)
    finally:
        others.close()
        page.close()


def _explore(result: Path, options: PageOptions, beside: Path | None) -> None:
    """Show the result of a sweep."""
    with user_errors():
        if beside is not None:
            raise ValueError(f"{result}: a sweep is shown alone; leave {beside} out")
        check_place(options.host, options.http_port, options.public_name)
        from concord.dashboard.sweeps.sweep_page import SweepPage
        from concord.dashboard.theme import DARK, LIGHT
        from concord.experiments.explored_sweep import UP, RunPages, swept_of
        from concord.studies.sweep.results import read_result

        dataset = read_result(result)
        theme = LIGHT if options.light else DARK
        swept, runs = swept_of(dataset, result.name), RunPages(dataset, result, options)
        page = SweepPage(swept, runs.open, options.host, options.http_port, theme, UP)
    sys.stderr.write(f"{page.url}  (Ctrl-C ends)\n")
    try:
        page.run(lambda: False)
    finally:
        page.close()
        runs.close()


def _recorded(named: Path) -> tuple["Description", Path]:
    """Return run.json of a run, named by its folder or a file in it, and its recording.

    Raises:
        ValueError: there is none.
    """
    from concord.results.folder import read_shown, recording_of

    folder = named.parent if named.is_file() else named
    recording = recording_of(folder)
    return read_shown(folder), recording
