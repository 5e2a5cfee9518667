"""Means of the environment process beside the network: start and end nodes, check settings."""

from collections.abc import Callable
from typing import NamedTuple

from concord.nodes.changes import Settings


class Management(NamedTuple):
    """`kill(node)` and `start(node, life)` its process, `check(before, asked)` what people want to
    set, `on_step(completed)`; `setup` is JSON to be shown. Where it `keeps_nodes` it can kill and
    start them; others' processes are on other hosts. `NodeEnded` is read from the descriptor
    `ends`."""

    kill: Callable[[int], None]
    start: Callable[[int, int], None]
    check: Callable[[Settings, Settings], Settings]
    on_step: Callable[[int], None]
    setup: bytes
    ends: int
    keeps_nodes: bool = True
