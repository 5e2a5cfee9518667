"""Starts of nodes' processes, and their ends as the launcher process reports them.

A process that ends while it starts has no liveliness token yet, so the network does not see it.
"""

import os
import threading
from collections.abc import Callable

import msgspec

from concord.runtime.processes.job import NodeEnded


class NodeLives:
    """Starts processes of nodes and numbers them: an end may be told after the next was ordered.

    `newest[node]` is the number of the newest process of a node, 0 for the first.
    """

    def __init__(self, nodes: int, start: Callable[[int, int], None]) -> None:
        self.newest = [0] * nodes
        self._start = start

    def start(self, node: int) -> None:
        """Have a fresh process of a node started."""
        self.newest[node] += 1
        self._start(node, self.newest[node])


def follow_ends(descriptor: int, notify: Callable[[NodeEnded], None]) -> None:
    """Notify of each end that is written to the pipe, in a thread of its own."""
    reports = os.fdopen(os.dup(descriptor), "rb")

    def read() -> None:
        with reports:
            for line in reports:
                notify(msgspec.json.decode(line, type=NodeEnded))

    threading.Thread(target=read, daemon=True).start()
