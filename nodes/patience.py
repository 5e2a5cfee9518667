"""What ends a process that has been alone for too long."""

import os
import sys

from nodes.absence import Absence


class Patience:
    """Ends this process when somebody has been out of reach for so many seconds on end."""

    def __init__(self, name: str, seconds: float) -> None:
        self._name, self._seconds = name, seconds
        self._absence = Absence(seconds, self._leave)

    def see(self, name: str, is_there: bool) -> None:
        """Somebody has come, or is gone."""
        if name == self._name:
            self._absence.see(name, is_there)

    def _leave(self, _name: str) -> None:
        sys.stderr.write(f"the {self._name} has been out of reach for {self._seconds:g} s\n")
        # The loop that waits for it cannot be interrupted.
        os._exit(1)
