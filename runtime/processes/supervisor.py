"""Forked children and their end: no child is left behind, whatever happens to the others.

The parent must be clean: it has imported what the children need, with one BLAS thread, and has
opened no zenoh session (its threads would not survive a fork). Children live as long as the parent:
each watches a pipe whose other end only the parent holds, and Linux kills each with its parent. A
child that is stopped watches nothing.
"""

import ctypes
import os
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from types import FrameType
from typing import NamedTuple

from concord.scenarios.user.faults import fault_sentence, last_line

TRY_AGAIN = 75
_GRACE_S = 1.0
_SET_PARENT_DEATH_SIGNAL = 1
# Loaded before a fork, after which loading could wait for a lock that nobody holds.
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None


class Ended(NamedTuple):
    """A child that is gone: its name and exit code (negative: the signal that killed it)."""

    name: str
    code: int


class Supervisor:
    """Starts children by fork, tells of their ends, and ends them all."""

    def __init__(self) -> None:
        self._children: dict[int, str] = {}
        self._lifeline_read, self._lifeline_write = os.pipe()
        self._wake_read, wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(wake_write, False)
        signal.signal(signal.SIGCHLD, _ignore)
        signal.set_wakeup_fd(wake_write, warn_on_full_buffer=False)

    @property
    def pids(self) -> dict[str, int]:
        """Process numbers of the living children by name."""
        return {name: pid for pid, name in self._children.items()}

    def start(self, name: str, work: Callable[[], None]) -> None:
        """Fork a child that does `work` and exits: 0, TRY_AGAIN if it says so, 1 on an error."""
        parent = os.getpid()
        pid = os.fork()
        if pid:
            self._children[pid] = name
            return
        code = 1
        try:
            os.close(self._lifeline_write)
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            # Ctrl-C is for the launcher, which ends all children in order.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal_at_parents_end(signal.SIGKILL)
            if os.getppid() != parent:
                # It ended before the kernel was asked.
                os._exit(1)
            threading.Thread(target=_die_with, args=(self._lifeline_read,), daemon=True).start()
            work()
            code = 0
        except SystemExit as wish:
            code = wish.code if isinstance(wish.code, int) else 1
        except BaseException as error:
            line = last_line(error)
            words = f"{fault_sentence(error)}\n" if line else traceback.format_exc()
            sys.stderr.write(f"{name}: {words}")
        finally:
            # Never the parent's exit handlers, never a wait for zenoh's threads.
            os._exit(code)

    def kill(self, name: str) -> None:
        """End the child of that name, if there is one, without a word."""
        for pid, called in self._children.items():
            if called == name:
                os.kill(pid, signal.SIGKILL)

    def wait(self, *also: int) -> Ended | int:
        """Wait for the end of a child, or until one of the file descriptors `also` can be read."""
        while True:
            ended = self._reap()
            if ended:
                return ended
            readable, _, _ = select.select([self._wake_read, *also], [], [])
            if self._wake_read in readable:
                _drain(self._wake_read)
            elif readable:
                return readable[0]

    def _reap(self) -> Ended | None:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return None
        if pid == 0:
            return None
        return Ended(self._children.pop(pid), os.waitstatus_to_exitcode(status))

    def stop(self, grace_s: float = 0.0) -> None:
        """End all children: wait `grace_s` for those that leave, then ask, then kill."""
        self._wait_gone(grace_s)
        for signal_number in (signal.SIGTERM, signal.SIGKILL):
            for pid in self._children:
                os.kill(pid, signal_number)
            self._wait_gone(_GRACE_S)

    def _wait_gone(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while self._children:
            if self._reap():
                continue
            left = deadline - time.monotonic()
            if left <= 0:
                return
            select.select([self._wake_read], [], [], left)
            _drain(self._wake_read)


def signal_at_parents_end(number: signal.Signals) -> None:
    """Have the kernel send this process a signal when its parent ends; on Linux alone.

    The signal reaches a process that is stopped, which reads no pipe (prctl(2), PR_SET_PDEATHSIG).
    """
    if _LIBC is not None:
        _LIBC.prctl(_SET_PARENT_DEATH_SIGNAL, int(number))


def _ignore(_signal: int, _frame: FrameType | None) -> None:
    """A handler that does nothing: SIGCHLD only has to wake the supervisor up."""


def _drain(descriptor: int) -> None:
    try:
        while os.read(descriptor, 512):
            pass
    except BlockingIOError:
        pass


def _die_with(lifeline: int) -> None:
    """Block until the parent is gone, then go too."""
    os.read(lifeline, 1)
    os._exit(1)
