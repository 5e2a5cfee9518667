"""Inputs of users: read when they arrive, handled in order.

viser stores a browser's input in its event loop and later calls an ordinary function in any of its
threads. That function would read the last stored value, perhaps one that the drawing loop wrote. So
the event loop reads each value at once, and the values are handled one after another.
"""

from asyncio import AbstractEventLoop
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any

from concord.dashboard.view import View


def at_once(act: Callable[[Any], None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """A callback of viser's that does `act(event)` in the event loop, where it must not wait; what
    Python itself has assigned is not heard."""

    async def hear(event: Any) -> None:
        if event.client is not None:
            act(event)

    return hear


class Inputs:
    """Changes of the view wait here for the loop that draws; `wake` tells it that some do."""

    def __init__(self, loop: AbstractEventLoop, wake: Callable[[], None]) -> None:
        self._loop, self._wake = loop, wake
        self._changes: deque[Callable[[View], object]] = deque()

    def alter(self, change: Callable[[View], object]) -> None:
        """Have the view changed before the next picture; from any thread."""
        self._changes.append(change)
        self._wake()

    def select(self, node: int | None) -> None:
        """Select a node, everywhere."""
        self.alter(lambda view: setattr(view, "selected", node))

    def point(self, node: int | None) -> None:
        """Mark the node at which a pointer rests, or none."""
        self.alter(lambda view: setattr(view, "hovered", node))

    def apply(self, view: View) -> None:
        """Do what has been asked for; by whoever draws, with the view's lock."""
        while self._changes:
            self._changes.popleft()(view)

    def show(self, widget: Any, **properties: Any) -> None:
        """Assign properties of a widget that people change too."""
        self._loop.call_soon_threadsafe(_assign, widget, properties)


def _assign(widget: Any, properties: dict[str, Any]) -> None:
    for name, value in properties.items():
        setattr(widget, name, value)
