"""Start a command under test, find its processes, and wait for their end."""

import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

MARK = "CONCORD_TEST_MARK"
PROC = Path("/proc")
CONCORD = (sys.executable, "-m", "concord.experiments")
# On an idle machine a command ends at once within 3 s, and its descendants 0.5 s after it.
_AT_ONCE_S = 3.0
_LEFT_S = 0.5
# Waiting for a certain event ends after this many seconds; a defect makes it last for ever.
PATIENCE_S = 60.0


class Family:
    """A command and everything that it started, told by a mark that children inherit."""

    def __init__(self, command: Sequence[str], folder: Path, interactive: bool) -> None:
        self.mark = uuid.uuid4().hex
        self.process = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, MARK: self.mark},
            stdin=subprocess.PIPE if interactive else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._began_s = time.monotonic()
        self._first_line_s = 0.0

    @property
    def at_once_s(self) -> float:
        """Return within how many seconds this command must end: 3 on an idle machine.

        A busy machine delays the end as it has delayed the start. The limit is at least twice the
        time to the first line that a test awaited.
        """
        return max(_AT_ONCE_S, 2 * self._first_line_s)

    def gone_at_once(self) -> bool:
        """Wait until no process is left, 0.5 s on an idle machine."""
        return self.gone_within(self.at_once_s * _LEFT_S / _AT_ONCE_S)

    def alive(self) -> list[int]:
        """Return the process numbers of the living processes; a zombie is not one."""
        sign = f"{MARK}={self.mark}".encode()
        return [pid for pid in _processes() if sign in _read(pid, "environ")]

    def descendants(self) -> list[int]:
        """Return the living processes without the command itself."""
        return [pid for pid in self.alive() if pid != self.process.pid]

    def gone_within(self, seconds: float) -> bool:
        """Wait until no process is left; return whether that happened."""
        return holds_within(seconds, lambda: not self.alive())

    def send(self, signal_number: int) -> None:
        """A signal to the command alone."""
        os.kill(self.process.pid, signal_number)

    def send_to_a_thread(self, signal_number: int) -> None:
        """A signal to the command that the kernel gives to another of its threads than the main."""
        threads = (int(path.name) for path in (PROC / f"{self.process.pid}/task").iterdir())
        # Linux prefers the thread whose number it is.
        os.kill(max(threads), signal_number)

    def send_to_group(self, signal_number: int) -> None:
        """A signal to all that a terminal would send it to."""
        os.killpg(self.process.pid, signal_number)

    def await_line(self, part: str, seconds: float = PATIENCE_S) -> str:
        """Read standard error up to a line that has this in it."""
        return self._read_until(lambda line: part in line, part, self.process.stderr, seconds)

    def await_output(self, holds: Callable[[str], bool], seconds: float = PATIENCE_S) -> str:
        """Read standard output up to a line for which something holds."""
        return self._read_until(holds, "the output", self.process.stdout, seconds)

    def _read_until(
        self, holds: Callable[[str], bool], sought: str, stream: IO[str] | None, seconds: float
    ) -> str:
        assert stream is not None
        said = []
        # The end of the command ends the reading.
        watch = threading.Timer(seconds * slowdown(), self.kill_all)
        watch.start()
        try:
            while line := stream.readline():
                said.append(line)
                if holds(line):
                    self._first_line_s = self._first_line_s or time.monotonic() - self._began_s
                    return line
        finally:
            watch.cancel()
        trouble = "" if stream is self.process.stderr else self.process.stderr.read()  # type: ignore[union-attr]
        raise AssertionError(f"no line with {sought!r}, but {said}; {trouble}")

    def end(self, seconds: float = 3.0) -> tuple[int, str, str]:
        """Wait for the command: exit code, standard output and standard error."""
        out, err = self.process.communicate(timeout=seconds * slowdown())
        return self.process.returncode, out, err

    def kill_all(self) -> None:
        """Whatever a failing test has left behind."""

        def all_dead() -> bool:
            pids = self.alive()
            for pid in pids:
                _kill(pid)
            return not pids

        assert holds_within(PATIENCE_S, all_dead), f"processes {self.alive()} do not end"


@contextmanager
def family(command: Sequence[str], folder: Path, interactive: bool = False) -> Iterator[Family]:
    """A command, with a standard input if `interactive`; nothing of it outlives the block."""
    started = Family(command, folder, interactive)
    try:
        yield started
    finally:
        started.kill_all()
        started.process.wait()
        for stream in (started.process.stdin, started.process.stdout, started.process.stderr):
            if stream is not None:
                stream.close()


def interrupted(run: Family, begun: Callable[[], object]) -> str:
    """Standard error of a command that Ctrl-C ends, with all its workers, once it has begun."""
    assert holds_within(PATIENCE_S, begun)
    run.send_to_group(signal.SIGINT)
    code, _, said = run.end(PATIENCE_S)
    assert code == 130 and "Traceback" not in said, said
    assert run.gone_within(10)
    return said


def slowdown() -> float:
    """How many times longer than on an idle machine something may take now.

    It is twice the number of threads for each processor: of those that run, or that ran in the
    last minute.
    """
    in_the_last_minute, *_, running, _ = (
        (PROC / "loadavg").read_text().replace("/", " ").split()[:5]
    )
    threads = max(float(in_the_last_minute), float(running))
    return max(1.0, 2 * threads / (os.cpu_count() or 1))


def holds_within(
    seconds: float,
    holds: Callable[[], object],
    wait: Callable[[], object] = lambda: time.sleep(0.01),
) -> bool:
    """Whether something becomes true in so many seconds of an idle machine.

    `wait` passes the time between two looks.
    """
    began_s = time.monotonic()
    while not holds():
        if time.monotonic() - began_s > seconds * slowdown():
            return False
        wait()
    return True


def lives(pid: int) -> bool:
    """Whether a process is there and not merely waiting to be reaped."""
    # The command's name is in brackets and may hold anything; the state follows it.
    status = _read(pid, "stat").rpartition(b")")[2].split()
    return bool(status) and status[0] not in (b"Z", b"X")


def _processes() -> list[int]:
    return [int(entry.name) for entry in PROC.iterdir() if entry.name.isdecimal()]


def _read(pid: int, name: str) -> bytes:
    try:
        return (PROC / str(pid) / name).read_bytes()
    except OSError:  # it has ended, or is not ours
        return b""


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
