"""The buttons that hand something over; each works in the thread of its click."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import viser

from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.stage import Stage
from concord.dashboard.panels.chart import Drawn
from concord.dashboard.panels.chart_export import charts_page, charts_picture
from concord.dashboard.panels.export import animated_scene, screenshot, zipped
from concord.dashboard.scene.camera import Free, aimed
from concord.dashboard.theme import QUIET_BUTTON
from concord.dashboard.view import View

_EXPORTED = Free(1000.0, 520.0, 40.0, 60.0, 960.0, 480.0)


class Shown(NamedTuple):
    """The content of a page at one moment; `view` is a copy."""

    stage: Stage
    view: View
    history: FrameHistory
    charts: Sequence[Drawn]


class ExportButtons:
    """Buttons for a screenshot, an animated scene, the charts, and the folder of the run if known.

    Runs on: viser's threads of clicks. `shown()` returns what the page shows at that moment,
    and `free(client)` what the panels of a client leave to the scene.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        shown: Callable[[], Shown],
        folder: Path | None,
        free: Callable[[viser.ClientHandle], Free | None],
    ) -> None:
        self._shown, self._folder, self._free = shown, folder, free
        icon = viser.Icon
        with gui.add_folder("Export", expand_by_default=False):
            self.picture: Any = gui.add_button("Scene (.png)", color=QUIET_BUTTON, icon=icon.CAMERA)
            self.scene: Any = gui.add_button("Run (.html)", color=QUIET_BUTTON, icon=icon.MOVIE)
            self.charts: Any = gui.add_button(
                "Charts (.html)", color=QUIET_BUTTON, icon=icon.CHART_LINE
            )
            self.chart_picture: Any = gui.add_button(
                "Charts (.png)", color=QUIET_BUTTON, icon=icon.PHOTO
            )
            if folder is not None:
                self.run: Any = gui.add_button(
                    "Run folder (.zip)", color=QUIET_BUTTON, icon=icon.FILE_ZIP
                )
                self.run.on_click(self._give_run)
        self.picture.on_click(self._give_picture)
        self.scene.on_click(self._give_scene)
        self.charts.on_click(self._give_charts)
        self.chart_picture.on_click(self._give_chart_picture)

    def _give_picture(self, event: Any) -> None:
        shown = self._shown()
        if event.client is None or not len(shown.history):
            return
        picture = screenshot(
            event.client, shown.view, shown.history.at(shown.view.step), self._free(event.client)
        )
        self._give(event.client, shown, "png", picture)

    def _give_scene(self, event: Any) -> None:
        shown = self._shown()
        if event.client is None or not len(shown.history):
            return
        # The exported page leaves the scene another room than this window does.
        camera = aimed(shown.stage.in_scene(shown.stage.whereabouts, 0.15), _EXPORTED)
        frames = shown.history.until(shown.view.step, 2000)
        html = animated_scene(shown.stage, shown.view, frames, camera, shown.charts)
        self._give(event.client, shown, "run.html", html.encode())

    def _give_charts(self, event: Any) -> None:
        if event.client is not None:
            shown = self._shown()
            html = charts_page(shown.stage, shown.charts, shown.view)
            self._give(event.client, shown, "charts.html", html.encode())

    def _give_chart_picture(self, event: Any) -> None:
        if event.client is not None:
            shown = self._shown()
            picture = charts_picture(shown.stage, shown.charts, shown.view)
            self._give(event.client, shown, "charts.png", picture)

    def _give_run(self, event: Any) -> None:
        if event.client is not None and self._folder is not None:
            self._give(event.client, self._shown(), "zip", zipped(self._folder))

    def _give(self, client: viser.ClientHandle, shown: Shown, ending: str, data: bytes) -> None:
        name = f"{shown.stage.setup.scenario.name}-step{shown.view.step}.{ending}"
        client.send_file_download(name, data, save_immediately=True)
