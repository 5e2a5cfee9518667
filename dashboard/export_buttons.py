"""The buttons that hand something over; each works in the thread of its click."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import viser

from dashboard.camera import Camera
from dashboard.chart_export import charts_page, charts_picture
from dashboard.controls import QUIET
from dashboard.export import animated_scene, screenshot, zipped

if TYPE_CHECKING:
    from dashboard.app import Dashboard


class ExportButtons:
    """Screenshot, animated scene, charts, and the run's folder where there is one."""

    def __init__(self, gui: viser.GuiApi, page: "Dashboard", folder: Path | None) -> None:
        self._page, self._folder = page, folder
        icon = viser.Icon
        with gui.add_folder("Export"):
            self.picture: Any = gui.add_button("Scene (.png)", color=QUIET, icon=icon.CAMERA)
            self.scene: Any = gui.add_button("Animated scene (.html)", color=QUIET, icon=icon.MOVIE)
            self.charts: Any = gui.add_button("Charts (.html)", color=QUIET, icon=icon.CHART_LINE)
            self.chart_picture: Any = gui.add_button("Charts (.png)", color=QUIET, icon=icon.PHOTO)
            if folder is not None:
                self.run: Any = gui.add_button("Run folder (.zip)", color=QUIET, icon=icon.FILE_ZIP)
                self.run.on_click(self._give_run)
        self.picture.on_click(self._give_picture)
        self.scene.on_click(self._give_scene)
        self.charts.on_click(self._give_charts)
        self.chart_picture.on_click(self._give_chart_picture)

    def _give_picture(self, event: Any) -> None:
        if event.client is not None:
            self._give(event.client, "png", screenshot(event.client))

    def _give_scene(self, event: Any) -> None:
        page = self._page
        if event.client is None or not len(page.history):
            return
        view = page.snapshot()
        seen = event.client.camera
        camera = Camera(tuple(seen.position), tuple(seen.look_at))
        frames = page.history.until(view.step, 2000)
        html = animated_scene(page.stage, view, frames, camera)
        self._give(event.client, "scene.html", html.encode())

    def _give_charts(self, event: Any) -> None:
        if event.client is not None:
            page = self._page
            html = charts_page(page.stage, page.charts.drawn, page.snapshot())
            self._give(event.client, "charts.html", html.encode())

    def _give_chart_picture(self, event: Any) -> None:
        if event.client is not None:
            page = self._page
            picture = charts_picture(page.stage, page.charts.drawn, page.snapshot())
            self._give(event.client, "charts.png", picture)

    def _give_run(self, event: Any) -> None:
        if event.client is not None and self._folder is not None:
            self._give(event.client, "zip", zipped(self._folder))

    def _give(self, client: viser.ClientHandle, ending: str, data: bytes) -> None:
        name = self._page.stage.setup.scenario.name
        client.send_file_download(
            f"{name}-step{self._page.view.step}.{ending}", data, save_immediately=True
        )
