"""The end of a process that has been without a peer for too long."""

import math
import os
import sys

from concord.runtime.processes.departed_peers import DepartedPeers


class PeerTimeout:
    """Ends this process when a peer has been out of reach for so many seconds on end.

    With infinite `seconds` it never does.
    """

    def __init__(self, name: str, seconds: float) -> None:
        self._name, self._seconds = name, seconds
        self._departed = DepartedPeers(seconds, self._leave)

    def see(self, name: str, is_there: bool) -> None:
        """A process has come, or is gone. Runs on: a thread of zenoh's."""
        if name == self._name and self._seconds < math.inf:
            self._departed.see(name, is_there)

    def _leave(self, _name: str) -> None:
        sys.stderr.write(f"the {self._name} has been out of reach for {self._seconds:g} s\n")
        # The loop that waits for the peer cannot be interrupted.
        os._exit(1)
