"""What ends a process that has been alone for too long."""

import os
import sys
import threading


class Patience:
    """Ends this process when somebody has been out of reach for so many seconds on end."""

    def __init__(self, name: str, seconds: float) -> None:
        self._name, self._seconds = name, seconds
        self._timer: threading.Timer | None = None

    def see(self, name: str, is_there: bool) -> None:
        """Somebody has come, or is gone."""
        if name != self._name:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if not is_there:
            self._timer = threading.Timer(self._seconds, self._leave)
            self._timer.daemon = True
            self._timer.start()

    def _leave(self) -> None:
        sys.stderr.write(f"the {self._name} has been out of reach for {self._seconds:g} s\n")
        # The loop that waits for it cannot be interrupted.
        os._exit(1)
