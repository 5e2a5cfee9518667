"""Where the panels are: controls left, charts and tables right, bus below, zoom above the scene."""

from collections.abc import Callable
from typing import Any, NamedTuple

import viser

from concord.dashboard.scene.camera import Free

# Edges of the docks; what the scene keeps from the panels, in pixels.
_DOCK, _MARGIN = 8, 26


class Panels(NamedTuple):
    """The places that are filled; each but `main` is a tab that is a context manager."""

    charts: Any
    state: Any
    log: Any
    nodes: Any
    selected: Any
    bus: Any
    zoom: Any
    states: Any
    arrange: Callable[[int, int], Free]


def lay_out(server: viser.ViserServer, states_first: bool) -> Panels:
    """Make the panels of the page; beside the scene lie states or beliefs on top."""
    gui = server.gui
    icon = viser.Icon
    upper = gui.add_panel()
    charts = upper.add_tab("Charts", icon.CHART_LINE)
    state = upper.add_tab("One state", icon.CHART_DOTS)
    log = upper.add_tab("Log", icon.LIST)
    lower = gui.add_panel()
    nodes = lower.add_tab("Nodes", icon.TABLE)
    selected = lower.add_tab("Selected", icon.FOCUS_2)
    bus_panel, zoom_panel = gui.add_panel(), gui.add_panel()
    bus = bus_panel.add_tab("Bus", icon.TIMELINE)
    corner = {"States": icon.WAVE_SINE, "Beliefs": icon.ZOOM_IN}
    order = sorted(corner, reverse=states_first)
    tabs = {name: zoom_panel.add_tab(name, corner[name]) for name in order}

    def arrange(width: int, height: int) -> Free:
        """Fit the panels into a window of that size in pixels; returns what they leave of the
        scene."""
        narrow = width < 1500
        left, right = (248, 344) if narrow else (272, 384)
        gui.main_panel.dock_left()
        gui.main_panel.set_width(left)
        upper.dock_right()
        upper.set_width(right)
        lower.dock_below(upper)
        canvas = max(width - left - right - _DOCK, 360)
        bus_height = _bus_height(canvas)
        bus_panel.float(x=8, y=-8, width=canvas - 10, height=bus_height)
        size = 214 if narrow else 262
        zoom_panel.float(x=-8, y=8, width=size, height=size + 100)
        covered = size + 8 + _MARGIN
        bottom = max(height - 8 - bus_height - _MARGIN, 3 * _MARGIN)
        return Free(canvas, height, _MARGIN, 2 * _MARGIN, canvas - covered, bottom)

    return Panels(
        charts, state, log, nodes, selected, bus, tabs["Beliefs"], tabs["States"], arrange
    )


def _bus_height(canvas: int) -> int:
    """The drawing keeps its shape; below it are a legend and the slider."""
    return round(canvas * 0.17) + 112
