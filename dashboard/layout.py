"""Where the panels are: controls left, charts and tables right, bus below, zoom above the scene.

Each browser has a layout of its own, which fits its window.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import viser

from concord.dashboard.scene.camera import Free

# Edges of the docks; what the scene keeps from the panels, in pixels.
_DOCK, _MARGIN = 8, 26
# A docked panel that is minimized leaves a strip.
_STRIP = 40
# Below this width viser shows all panels in one column, whatever their places.
PHONE_WIDTH = 576
SMALL_WIDTH, _WIDE_WIDTH = 1100, 1500


class Panels(NamedTuple):
    """The places that are filled; each but `main` is a tab that is a context manager."""

    charts: Any
    state: Any
    log: Any
    nodes: Any
    selected: Any
    help: Any
    bus: Any
    zoom: Any
    states: Any
    ratios: Any
    arrange: Callable[[viser.ClientHandle, int, int, bool], Free]


class Columns(NamedTuple):
    """Widths of the controls, of the charts, and of the zoomed picture, in pixels."""

    left: int
    right: int
    zoom: int


def columns_for(width: int) -> Columns:
    """Return the widths of the panels in a window of so many pixels."""
    if width < SMALL_WIDTH:
        return Columns(_STRIP, 300, 200)
    if width < _WIDE_WIDTH:
        return Columns(248, 344, 214)
    return Columns(272, 384, 262)


def lay_out(server: viser.ViserServer, states_first: bool, is_compared: bool = False) -> Panels:
    """Make the panels of the page; beside the scene lie states or beliefs on top.

    A page that compares two runs has a table of their ratios; `ratios` is None on others.
    """
    gui = server.gui
    icon = viser.Icon
    upper = gui.add_panel()
    charts = upper.add_tab("Charts", icon.CHART_LINE)
    state = upper.add_tab("One state", icon.CHART_DOTS)
    log = upper.add_tab("Log", icon.LIST)
    lower = gui.add_panel()
    nodes = lower.add_tab("Nodes", icon.TABLE)
    ratios = lower.add_tab("Ratios", icon.SCALE) if is_compared else None
    selected = lower.add_tab("Selected", icon.FOCUS_2)
    legend = lower.add_tab("Help", icon.HELP)
    bus_panel, zoom_panel = gui.add_panel(), gui.add_panel()
    bus = bus_panel.add_tab("Bus", icon.TIMELINE)
    corner = {"States": icon.WAVE_SINE, "Beliefs": icon.ZOOM_IN}
    order = sorted(corner, reverse=states_first)
    tabs = {name: zoom_panel.add_tab(name, corner[name]) for name in order}

    def arrange(client: viser.ClientHandle, width: int, height: int, presents: bool) -> Free:
        """Fit the panels into a client's window of that size in pixels; return the part of the
        window that they leave to the scene."""
        if width < PHONE_WIDTH:
            # The column covers the lower three fifths once it is opened.
            return Free(width, height, _MARGIN, _MARGIN, width - _MARGIN, 0.4 * height - _MARGIN)
        columns = dock_columns(client, width, upper, lower, presents)
        canvas = max(width - columns.left - columns.right - _DOCK, 360)
        bus_height = round(canvas * 0.23) + (150 if presents else 112)
        place_of(client, bus_panel).float(x=8, y=-8, width=canvas - 10, height=bus_height)
        size = columns.zoom
        corner_panel = place_of(client, zoom_panel)
        corner_panel.float(x=-8, y=8, width=size, height=size + 100)
        if width < SMALL_WIDTH or presents:
            corner_panel.minimize()
            covered = _MARGIN
        else:
            corner_panel.expand()
            covered = size + 8 + _MARGIN
        bottom = max(height - 8 - bus_height - _MARGIN, 3 * _MARGIN)
        return Free(canvas, height, _MARGIN, 2 * _MARGIN, canvas - covered, bottom)

    return Panels(
        charts, state, log, nodes, selected, legend, bus, tabs["Beliefs"], tabs["States"], ratios,
        arrange,
    )  # fmt: skip


def dock_columns(
    client: viser.ClientHandle,
    width: int,
    upper: viser.PanelHandle,
    lower: viser.PanelHandle,
    presents: bool = False,
) -> Columns:
    """Dock the controls left, and two panels right, in a window of so many pixels."""
    columns = columns_for(width)
    if presents:
        columns = Columns(290, 390, columns.zoom)
    main, right = client.gui.main_panel, place_of(client, upper)
    main.dock_left()
    if width < SMALL_WIDTH and not presents:
        main.minimize()
    else:
        main.expand()
        main.set_width(columns.left)
    right.dock_right()
    right.set_width(columns.right)
    beside = place_of(client, lower)
    if presents:
        # Floating: a docked one that is minimized takes the charts with it.
        beside.float(x=8, y=8)
        beside.minimize()
    else:
        beside.expand()
        beside._set_position(
            {"kind": "split", "anchor_uuid": upper._placement_uuid, "side": "below"}
        )
    return columns


def place_of(client: viser.ClientHandle, panel: viser.PanelHandle) -> viser.MainPanelHandle:
    """Return a handle that places a panel of all browsers in the window of one.

    viser has handles of one scope only; a handle of the main panel is bound to a client and to an
    identity. The version of viser is pinned, and a browser test fails if that changes.
    """
    handle = client.gui.main_panel
    handle._placement_uuid = panel._placement_uuid
    return handle
