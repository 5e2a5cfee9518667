"""The page of a sweep: linked pictures of its cells, and runs that open as pages of their own."""

import contextlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from html import escape
from threading import Event as Flag
from typing import Any

import viser

from concord.dashboard.bridge import Bridge
from concord.dashboard.failures import PanelFailures
from concord.dashboard.inputs import at_once
from concord.dashboard.layout import PHONE_WIDTH, dock_columns, place_of
from concord.dashboard.sweeps.details import cell_table, error_panel, runs_panel
from concord.dashboard.sweeps.limits import limit_widgets
from concord.dashboard.sweeps.scatter import axes_of, scatter
from concord.dashboard.sweeps.swept import Choices, FieldValue, SweptCells
from concord.dashboard.theme import DARK, LIGHT, Theme, css
from concord.dashboard.viewport import Viewports
from concord.dashboard.window import PageServer

OpenRun = Callable[[int, int, Callable[[int], None]], str]
"""(cell, place of the run, on_step) -> the address of the page of that run, once it is computed.

Raises:
    ValueError: the run cannot be computed or kept.
"""
_NONE = "none"
# Pixels of a window's height that the picture leaves to its tab and its legend.
_BESIDE = 110
# There is no scene, so that a phone has the whole window for the column of the panels.
_TALL = (
    "<style>@media(max-width:36em){.mantine-Paper-root:has(.concord-told)"
    "{max-height:100%!important;height:100%}}</style>"
)
# The address holds the host that this process knows, and the browser may know another.
_GO = (
    '<img src="data:," alt="" onerror="const to=new window.URL(\'%s\');'
    'to.hostname=location.hostname;location.assign(to)">'
)


class SweepPage:
    """One page on the result of a sweep; viser's event loop alone changes the choices."""

    def __init__(
        self, swept: SweptCells, open_run: OpenRun, host: str, port: int, theme: Theme, up: str
    ) -> None:
        self._swept, self._open_run = swept, open_run
        axes = axes_of(swept)
        self.choices = Choices(theme, axes[0], up if up in axes else axes[-1], swept.colour)
        self._changed = Flag()
        self._progress = ""
        self._failures = PanelFailures()
        self._worker = ThreadPoolExecutor(1)
        self._window = PageServer(host, port)
        self._window.set_theme(theme)
        self.server.scene.world_axes.visible = False
        gui, cells = self.server.gui, len(swept.rmse)
        self._status: Any = gui.add_html("")
        self._choose_picture(gui, axes)
        limit_widgets(gui, swept, self._limit)
        picture, self._right, self._lower = gui.add_panel(), gui.add_panel(), gui.add_panel()
        self._picture = picture
        with (tab := picture.add_tab("Cells", viser.Icon.CHART_DOTS)):
            self._scatter = Bridge(gui, cells, self._select, self._hover)
        with self._right.add_tab("Cell", viser.Icon.FOCUS_2):
            self._runs = Bridge(gui, len(swept.runs), self._open, lambda _: None)
            self._errors: Any = gui.add_html("")
        with self._lower.add_tab("Table", viser.Icon.TABLE):
            self._table = Bridge(gui, 2 * cells, self._press_row, self._hover_row)
        Viewports(gui, (contextlib.nullcontext(), tab), self._arrange)
        self._window.bind("Select no cell", "X", lambda _: self._select(None))

    @property
    def server(self) -> viser.ViserServer:
        """Return the server of the page."""
        return self._window.server

    @property
    def url(self) -> str:
        """Return the address of the page, with the token that lets a browser in."""
        return self._window.url

    def _choose_picture(self, gui: viser.GuiApi, axes: tuple[str, ...]) -> None:
        choices = self.choices
        with gui.add_folder("Picture"):
            for label, name, offered in (
                ("Across", "across", axes),
                ("Up", "up", axes),
                ("Colour", "colour", (_NONE, *self._swept.fields)),
            ):
                first = getattr(choices, name)
                chosen: Any = gui.add_dropdown(
                    label, offered, initial_value=first if first in offered else _NONE
                )
                self._bind(chosen, name)
            dark: Any = gui.add_checkbox("Dark", choices.theme.dark)

            def repaint(_: Any) -> None:
                choices.theme = DARK if dark.value else LIGHT
                self._window.set_theme(choices.theme)
                self._changed.set()

            dark.on_update(at_once(repaint))

        def turn(client: Any) -> None:
            dark.value = not dark.value
            repaint(client)

        self._window.bind("Dark or light", "D", turn)

    def _bind(self, widget: Any, name: str) -> None:
        def take(_: Any) -> None:
            setattr(self.choices, name, widget.value)
            self._changed.set()

        widget.on_update(at_once(take))

    def _limit(self, field: str, allowed: tuple[FieldValue, ...]) -> None:
        self.choices.limits = {**self.choices.limits, field: allowed}
        self._changed.set()

    def _arrange(self, client: viser.ClientHandle, width: int, height: int) -> None:
        """Fit the panels into a client's window of that size in pixels."""
        if width >= PHONE_WIDTH:
            columns = dock_columns(client, width, self._right, self._lower)
            across = width - columns.left - columns.right - 24
            place_of(client, self._picture).float(x=8, y=8, width=across, height=height - 16)
            self.choices.width, self.choices.height = across, max(height - _BESIDE, 300)
        else:
            place_of(client, self._picture).expand()
            self.choices.width, self.choices.height = width, 0.8 * width
        self._changed.set()

    def _select(self, cell: int | None) -> None:
        self.choices.selected = cell
        self._changed.set()

    def _hover(self, cell: int | None) -> None:
        self.choices.hovered = cell
        self._changed.set()

    def _hover_row(self, number: int | None) -> None:
        self._hover(None if number is None else number % len(self._swept.rmse))

    def _press_row(self, number: int) -> None:
        opens, cell = divmod(number, len(self._swept.rmse))
        self._select(cell)
        if opens and self._table.client is not None:
            self._start(cell, self._swept.middle_run(cell), self._table.client)

    def _open(self, place: int) -> None:
        cell = self.choices.selected
        if cell is not None and self._runs.client is not None:
            self._start(cell, place, self._runs.client)

    def _start(self, cell: int, place: int, client: viser.ClientHandle) -> None:
        self._worker.submit(self._compute, cell, place, client)

    def _compute(self, cell: int, place: int, client: viser.ClientHandle) -> None:
        """Compute a run and move the client's browser to its page; in the thread of runs."""
        words = f"run {self._swept.runs[place]} of {self._swept.words(cell)}"

        def tell(steps: int | None) -> None:
            so_far = "" if steps is None else f"{words}: {steps} steps are computed"
            self._progress = so_far
            self._changed.set()

        tell(0)
        try:
            url = self._open_run(cell, place, tell)
        except Exception as error:
            # The thread goes on with the next run, whatever was wrong with this one.
            self._window.tell(client, "This run cannot be shown", str(error), is_trouble=True)
        else:
            client.gui.add_html(_GO % url)
        finally:
            tell(None)

    def draw(self) -> None:
        """Draw everything that has changed."""
        swept, choices, theme = self._swept, self.choices, self.choices.theme
        attempt = self._failures.attempt
        parts = (
            (self._scatter, "Cells", scatter), (self._table, "Table", cell_table),
            (self._runs, "Runs", runs_panel), (self._errors, "Errors", error_panel),
        )  # fmt: skip
        drawn = [attempt(name, lambda draw=draw: draw(swept, choices)) for _, name, draw in parts]
        told = "<br>".join(escape(one) for one in (self._progress, *self._failures.sentences()))
        title = escape(swept.title)
        status = (
            f'{_TALL}<i class="concord-told" data-title="{title}" hidden></i>'
            f'<div style="padding:8px 10px;font-size:13px;color:{css(theme.text)}"><b>'
            f'{title}</b><div data-testid="progress" style="color:'
            f'{css(theme.sending)}">{told}</div></div>'
        )
        with self.server.atomic():
            self._status.content = status
            for (panel, *_), html in zip(parts, drawn, strict=True):
                if html is not None and panel.content != html:
                    panel.content = html

    def run(self, until: Callable[[], bool]) -> None:
        """Draw what changes until `until()` holds."""
        self.draw()
        while not until():
            if self._changed.wait(0.2):
                self._changed.clear()
                self.draw()

    def close(self) -> None:
        """End the page; a run that is being computed is finished first."""
        self._worker.shutdown(cancel_futures=True)
        self.server.stop()
