"""Where the panels are: controls left, charts and tables right, bus below, zoom above the scene."""

from collections.abc import Callable
from typing import Any, NamedTuple

import viser


class Panels(NamedTuple):
    """The places that are filled; each but `main` is a tab that is a context manager."""

    charts: Any
    state: Any
    log: Any
    nodes: Any
    selected: Any
    bus: Any
    zoom: Any
    arrange: Callable[[int, int], float]


def lay_out(server: viser.ViserServer) -> Panels:
    """Make the panels of the page."""
    gui = server.gui
    icon = viser.Icon
    upper = gui.add_panel()
    charts = upper.add_tab("Charts", icon.CHART_LINE)
    state = upper.add_tab("State", icon.WAVE_SINE)
    log = upper.add_tab("Log", icon.LIST)
    lower = gui.add_panel()
    nodes = lower.add_tab("Nodes", icon.TABLE)
    selected = lower.add_tab("Selected", icon.FOCUS_2)
    bus_panel, zoom_panel = gui.add_panel(), gui.add_panel()
    bus = bus_panel.add_tab("FlexRay bus", icon.TIMELINE)
    zoom = zoom_panel.add_tab("Beliefs", icon.ZOOM_IN)

    def arrange(width: int, height: int) -> float:
        """Fit the panels into a window of that size in pixels; returns width to height of what
        they leave for the scene."""
        narrow = width < 1500
        left, right = (248, 344) if narrow else (272, 384)
        gui.main_panel.dock_left()
        gui.main_panel.set_width(left)
        upper.dock_right()
        upper.set_width(right)
        lower.dock_below(upper)
        canvas = max(width - left - right, 360)
        bus_panel.float(x=8, y=-8, width=canvas - 18, height=_bus_height(canvas))
        size = 214 if narrow else 262
        zoom_panel.float(x=-8, y=8, width=size, height=size + 112)
        return canvas / max(height, 1)

    return Panels(charts, state, log, nodes, selected, bus, zoom, arrange)


def _bus_height(canvas: int) -> int:
    """The drawing keeps its shape; below it are a legend and the slider."""
    return round(canvas * 0.17) + 112
