"""Failures of panels: one that cannot be drawn is named on the page, and the others go on."""

import logging
from collections.abc import Callable
from typing import TypeVar

Drawn = TypeVar("Drawn")

# Without a handler of its own, logging writes to standard error.
_LOGGER = logging.getLogger("concord.dashboard")


class PanelFailures:
    """The panels that failed when they were last drawn, each with its error."""

    def __init__(self) -> None:
        self._lasting: dict[str, str] = {}
        self._told: set[tuple[str, type[Exception]]] = set()

    def attempt(self, panel: str, draw: Callable[[], Drawn]) -> Drawn | None:
        """Return `draw()`; None after an error, which is logged the first time and listed."""
        try:
            drawn = draw()
        except Exception as error:
            self._lasting[panel] = f"{type(error).__name__}: {error}"
            # A panel is drawn several times a second.
            if (panel, type(error)) not in self._told:
                self._told.add((panel, type(error)))
                _LOGGER.exception("%s cannot be drawn; the other panels go on", panel)
            return None
        self._lasting.pop(panel, None)
        return drawn

    def sentences(self) -> list[str]:
        """Return one sentence for each panel that fails now."""
        return [f"{panel} cannot be drawn: {error}" for panel, error in self._lasting.items()]
