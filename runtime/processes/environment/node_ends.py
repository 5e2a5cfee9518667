"""Ends of nodes' processes as the launcher process reports them.

A process that ends while it starts has no liveliness token yet, so the network does not see it.
"""

import os
import threading
from collections.abc import Callable

import msgspec

from concord.runtime.processes.job import NodeEnded


def follow_ends(descriptor: int, notify: Callable[[NodeEnded], None]) -> None:
    """Notify of each end that is written to the pipe, in a thread of its own."""
    reports = os.fdopen(os.dup(descriptor), "rb")

    def read() -> None:
        with reports:
            for line in reports:
                notify(msgspec.json.decode(line, type=NodeEnded))

    threading.Thread(target=read, daemon=True).start()
