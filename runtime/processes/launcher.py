"""A run over operating-system processes: start the launcher process, follow its reports, end it.

The launcher process (`launcher_process.py`) is a fresh Python process, so that forking is clean
whatever this one has imported. Its standard input is its lifeline: it ends everything when that
closes.
"""

import os
import resource
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import msgspec

from concord.disk import RunFailed
from concord.nodes.tempo import Tempo
from concord.runtime.interpreter import fresh_command, fresh_variables
from concord.runtime.network.network_file import NetworkAddresses, write_network
from concord.runtime.network.sockets import socket_folder
from concord.runtime.processes.job import Happened, Job
from concord.runtime.recording_repair import finish_recording
from concord.scenarios.setup import Setup

_STOP_TIMEOUT_S = 3.0
# How often the launcher looks whether a silent launcher process is there and runs.
_LOOK_S = 1.0
_SOON_FINISHED_BYTES = 100_000_000


class NetworkFailed(RunFailed):
    """A process of the network ended before the run did."""


def run_processes(
    setup: Setup,
    run: str,
    recording: Path,
    port: int | None,
    on_event: Callable[[Happened], None],
    tempo: Tempo | None = None,
    begins_paused: bool = False,
) -> None:
    """Run `setup` with one process per node; its messages are in `recording` when this returns.

    Args:
        setup: the compiled scenario.
        run: unique name of the run, part of every zenoh key.
        recording: the MCAP file to write.
        port: first of consecutive loopback ports, 0 for free ones, or None for unix sockets.
        on_event: told when the network is ready and as steps complete.
        tempo: that of real time, None for lockstep.
        begins_paused: in lockstep, step 0 waits for a command of the user.

    Raises:
        NetworkFailed: a process died; its last words are on standard error.
        ValueError: `port` cannot be used.
    """
    job = Job(setup, run, str(recording), port, tempo, begins_paused=begins_paused)
    run_job(job, recording.parent, on_event)


def raise_file_limit() -> None:
    """Let this process and its children open as many files as the system permits it to ask for."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def run_job(job: Job, folder: Path | None, on_event: Callable[[Happened], None]) -> None:
    """Run the processes of a job until the end; where the network is stands in `folder`.

    Raises:
        NetworkFailed: a process died; its last words are on standard error.
        ValueError: the job cannot be done.
    """
    raise_file_limit()
    if job.place is not None or job.port is not None:
        _run_job(job, folder, on_event)
        return
    with socket_folder() as sockets:
        _run_job(msgspec.structs.replace(job, sockets=sockets), folder, on_event)


def _run_job(job: Job, folder: Path | None, on_event: Callable[[Happened], None]) -> None:
    child = subprocess.Popen(
        fresh_command("concord.runtime.processes.launcher_process"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        # A network of many small processes: one BLAS thread each, or they fight for the cores.
        env=fresh_variables(OPENBLAS_NUM_THREADS="1"),
        # Ctrl-C is for us; the launcher process ends by its lifeline.
        start_new_session=True,
    )
    assert child.stdin is not None and child.stdout is not None
    is_loaded = False

    def hear(happened: Happened) -> None:
        nonlocal is_loaded
        is_loaded = True
        _note(job.run, folder, on_event, happened)

    try:
        child.stdin.write(msgspec.json.encode(job) + b"\n")
        child.stdin.flush()
        _follow(_reports(child, _Kept(job.recording)), hear)
    finally:
        if not is_loaded:
            # While the process loads its modules it does not read its lifeline. Children that it
            # has forked by now watch their own lifeline.
            child.terminate()
        child.stdin.close()
        child.stdout.close()
        try:
            child.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        # A disk that is full has said so already; `concord collect` tries again.
        recording = Path(job.recording)
        with suppress(OSError, ValueError):
            # A recorder that was killed left no summary; of a long run, `concord collect` finds it.
            if recording.is_file() and recording.stat().st_size < _SOON_FINISHED_BYTES:
                finish_recording(recording)


def _note(
    run: str, folder: Path | None, on_event: Callable[[Happened], None], happened: Happened
) -> None:
    """Write the addresses of the network, for subscribers."""
    if happened.connect and folder is not None:
        write_network(folder, NetworkAddresses(run, happened.connect, happened.pids))
    on_event(happened)


class _Kept:
    """Whether the recording of a run is where it was begun; "" is none."""

    def __init__(self, recording: str) -> None:
        self._recording, self._begun = recording, None
        self._next_s = time.monotonic() + _LOOK_S

    def look(self) -> None:
        """Look once a second.

        Raises:
            NetworkFailed: the recording is gone; what follows would be written to no file.
        """
        now_s = time.monotonic()
        if not self._recording or now_s < self._next_s:
            return
        self._next_s = now_s + _LOOK_S
        try:
            found = Path(self._recording).stat()
        except FileNotFoundError:
            found = None
        there = None if found is None else (found.st_dev, found.st_ino)
        if self._begun is not None and there != self._begun:
            raise NetworkFailed(
                f"{self._recording} was removed or moved while the run went on; what came after "
                "that is lost, so run it again"
            )
        self._begun = there


def _reports(child: subprocess.Popen[bytes], kept: _Kept) -> Iterator[bytes]:
    """Yield the lines of the launcher process until it closes its output or ends.

    Its children hold its output open, so its end alone does not close it.

    Raises:
        NetworkFailed: the recording is gone.
    """
    assert child.stdout is not None
    pending = b""
    while True:
        kept.look()
        readable, _, _ = select.select([child.stdout], [], [], _LOOK_S)
        if readable:
            read = os.read(child.stdout.fileno(), 65_536)
            if not read:
                return
            *lines, pending = (pending + read).split(b"\n")
            yield from lines
        elif child.poll() is not None:
            return
        else:
            # A process that is stopped sees no other process end.
            child.send_signal(signal.SIGCONT)


def _follow(lines: Iterator[bytes], on_event: Callable[[Happened], None]) -> None:
    decoder = msgspec.json.Decoder(Happened)
    for line in lines:
        happened = decoder.decode(line)
        match happened.what:
            case "done":
                return
            case "refused":
                raise ValueError(happened.detail)
            case "failed":
                raise NetworkFailed(happened.detail)
            case _:
                on_event(happened)
    raise NetworkFailed("the parent of the network's processes is gone; its last words are above")
