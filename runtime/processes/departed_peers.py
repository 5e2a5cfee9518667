"""Peers that have been out of reach for so long that their links are not expected back."""

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
