"""The end of a process that has been without a peer for too long."""

import math
import os
import sys
import threading
from collections.abc import Callable


class DepartedPeers:
    """Calls `told(name)`, in a thread of its own, when a peer has been away for `seconds`."""

    def __init__(self, seconds: float, told: Callable[[str], None]) -> None:
        self._seconds, self._told = seconds, told
        self._timers: dict[str, threading.Timer] = {}

    def see(self, name: str, is_there: bool) -> None:
        """A peer has come, or is gone."""
        timer = self._timers.pop(name, None)
        if timer is not None:
            timer.cancel()
        if not is_there:
            timer = self._timers[name] = threading.Timer(self._seconds, self._told, (name,))
            timer.daemon = True
            timer.start()


# How often a process says that it waits for a peer that it has never met.
_TELL_S = 10.0


class PeerTimeout:
    """Ends this process when a peer has been out of reach for so many seconds on end.

    With infinite `seconds` it never does.
    """

    def __init__(self, name: str, seconds: float) -> None:
        self._name, self._seconds = name, seconds
        self._departed = DepartedPeers(seconds, self._leave)
        self._met = threading.Event()

    def expect(self) -> None:
        """Count the time from now on, although the peer has not been there yet."""
        if self._seconds < math.inf and not self._met.is_set():
            self._departed.see(self._name, False)
            threading.Thread(target=self._tell, daemon=True).start()

    def see(self, name: str, is_there: bool) -> None:
        """A process has come, or is gone. Runs on: a thread of zenoh's."""
        if name == self._name and self._seconds < math.inf:
            self._met.set()
            self._departed.see(name, is_there)

    def _tell(self) -> None:
        waited_s = 0.0
        while not self._met.wait(_TELL_S):
            waited_s += _TELL_S
            sys.stderr.write(
                f"waits for the {self._name}: {waited_s:g} s of {self._seconds:g} are over\n"
            )

    def _leave(self, _name: str) -> None:
        sys.stderr.write(f"the {self._name} has been out of reach for {self._seconds:g} s\n")
        # The loop that waits for the peer cannot be interrupted.
        os._exit(1)
