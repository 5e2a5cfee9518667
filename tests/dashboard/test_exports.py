"""Test exported pages as users open them: in a browser, from a file, without a server."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.dashboard.app import Dashboard
from concord.dashboard.frames.expected import nothing_expected
from concord.dashboard.frames.source import replayed
from concord.dashboard.panels.chart import Curve, Drawn, Sample
from concord.dashboard.panels.chart_export import charts_page
from concord.dashboard.panels.chart_table import run_charts
from concord.dashboard.panels.charts import sampled
from concord.dashboard.panels.export import animated_scene, zipped
from concord.dashboard.scene.camera import Free, aimed
from concord.dashboard.serve import open_recording
from concord.dashboard.theme import LIGHT
from concord.dashboard.view import View
from concord.runtime.drivers import drive
from concord.runtime.recording import McapRecorder
from tests.dashboard.browser_tab import new_tab
from tests.dashboard.runs import run_of
from tests.processes import PATIENCE_S, holds_within

RUN = run_of("target-tracking", nodes=6, steps=30)
VIEW = View(theme=LIGHT, step=29, selected=2)
_DRAWN = (
    "()=>window.__viserTestpoints && window.__viserTestpoints.rendererInfo"
    " && window.__viserTestpoints.rendererInfo.render.frame>2"
)
_BELIEVED = (
    "()=>Array.from(window.__viserSceneTree.getState()['/plant/estimates']"
    "?.message.props.batched_positions ?? []).join()"
)
_TOLD = "(words)=>document.getElementById('told').textContent.startsWith(words)"
CHART_TITLES = ("RMSE", "Disagreement", "NEES", "NIS", "Payload")


def opened(chromium: Any, file: Path, query: str = "") -> tuple[Any, list[str]]:
    """A page on a file, and what it complains of; nothing but files may be loaded."""
    page = new_tab(chromium, 800, 600)
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("request", lambda request: _note_outside(request.url, troubles))
    page.goto(file.as_uri() + query)
    return page, troubles


def _note_outside(url: str, troubles: list[str]) -> None:
    if url.startswith(("http:", "https:", "ws:", "wss:")):
        troubles.append(url)


def test_the_animated_scene_is_a_page_that_moves_by_itself(chromium, tmp_path: Path):
    file = tmp_path / "scene.html"
    around = RUN.stage.in_scene(RUN.stage.whereabouts)
    camera = aimed(around, Free(800.0, 600.0, 20.0, 20.0, 780.0, 580.0))
    file.write_text(animated_scene(RUN.stage, VIEW, RUN.frames, camera))
    page, troubles = opened(chromium, file)
    try:
        page.wait_for_function(_DRAWN, timeout=60_000)
        before = page.evaluate(_BELIEVED)
        assert before, "what the nodes believe is in the scene"
        page.wait_for_function(f"(before)=>({_BELIEVED})() !== before", arg=before, timeout=60_000)
        # A picture needs a scene that rests: the space bar stops it.
        page.keyboard.press("Space")
        picture = _pixels(page.screenshot(timeout=60_000))
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20, "it is not blank"
        assert troubles == []
    finally:
        page.close()


def test_scene_bus_and_charts_of_an_exported_run_scrub_together(chromium, tmp_path: Path):
    view = View(theme=LIGHT, step=29)
    times = np.array([frame.time_s for frame in RUN.frames])
    sample = Sample(RUN.stage, view, RUN.frames, times, nothing_expected(times))
    charts = [
        Drawn(
            f"{chart.name} </script>",
            times,
            tuple(Curve(one.name, (9, 9, 9), False, one.column(sample)) for one in chart.lines),
        )
        for chart in run_charts(RUN.stage)
    ]
    camera = aimed(
        RUN.stage.in_scene(RUN.stage.whereabouts), Free(800.0, 600.0, 20.0, 20.0, 380.0, 380.0)
    )
    file = tmp_path / "run.html"
    file.write_text(animated_scene(RUN.stage, view, RUN.frames, camera, charts))
    page, troubles = opened(chromium, file, "?step=12")

    def told() -> str:
        return page.get_by_test_id("told").text_content() or ""

    def cursors() -> set[float]:
        lines = page.locator("aside .cursor").all()
        return {float(line.get_attribute("x1") or -1) for line in lines}

    try:
        page.wait_for_function(_DRAWN, timeout=60_000)
        page.wait_for_function(_TOLD, arg="step 12,", timeout=60_000)
        assert f"RMSE {RUN.frames[12].scores.rmse:.3g} m" in told()
        assert page.get_by_test_id("bus-cycle").text_content() == str(
            RUN.frames[12].cycles[-1].bus_cycle
        )
        assert len(cursors()) == 1, "all charts mark the same time"
        before, believed = cursors(), page.evaluate(_BELIEVED)
        chart = page.locator("aside svg").nth(1)
        box = chart.bounding_box()
        assert box
        # Step 25 of 0 to 29 lies there on the axis of time, which begins at 44 of 380 and ends at
        # 372.
        chart.click(position={"x": box["width"] * (44 + 328 * 25 / 29) / 380, "y": 40})
        page.wait_for_function(_TOLD, arg="step 25,", timeout=60_000)
        assert cursors() != before
        assert page.get_by_test_id("bus-cycle").text_content() == str(
            RUN.frames[25].cycles[-1].bus_cycle
        )
        page.wait_for_function(
            f"(before)=>({_BELIEVED})() !== before", arg=believed, timeout=60_000
        )
        assert troubles == []
    finally:
        page.close()


def _loaded(dashboard: Dashboard) -> bool:
    dashboard.history_add()
    return dashboard.source.pace().state != "LOADING"


def _pixels(picture: bytes) -> np.ndarray:
    from matplotlib.image import imread

    return (255 * imread(io.BytesIO(picture))[..., :3]).astype(int)


def test_the_charts_are_a_page_with_all_that_the_page_showed(chromium, tmp_path: Path):
    dashboard = open_recording(RUN.stage.setup, recorded(tmp_path), "127.0.0.1", 0, light=True)
    try:
        assert holds_within(PATIENCE_S, lambda: _loaded(dashboard)), "the recording never loaded"
        dashboard.page.charts.draw(sampled(RUN.stage, VIEW, dashboard.history, nothing_expected))
        file = tmp_path / "charts.html"
        file.write_text(charts_page(RUN.stage, dashboard.page.charts.drawn, VIEW))
    finally:
        dashboard.close()
    page, troubles = opened(chromium, file)
    try:
        said = page.locator("svg").all_text_contents()
        assert len(said) == 5
        for title, text in zip(CHART_TITLES, said, strict=True):
            assert title in text
        box = page.locator("svg").first.bounding_box()
        assert box
        assert 700 < box["width"] <= 800
        # The network has sent no bound and no band.
        assert "bound" not in said[0]
        assert troubles == []
    finally:
        page.close()


def recorded(place: Path) -> Path:
    """A recording of the run, in a folder of its own."""
    file = place / "run" / "run.mcap"
    file.parent.mkdir()
    recorder = McapRecorder(file, RUN.stage.rounds, RUN.stage.setup.time_step_s, SHARE_FRAMES)
    drive(RUN.stage.setup, recorder, lambda _: None)
    recorder.close()
    return file


def test_the_folder_of_a_run_can_be_replayed_from_its_archive(tmp_path: Path):
    folder = recorded(tmp_path).parent
    (folder / "run.json").write_text("{}")
    zipfile.ZipFile(io.BytesIO(zipped(folder))).extractall(tmp_path / "elsewhere")
    again = list(replayed(RUN.stage, tmp_path / "elsewhere" / "run" / "run.mcap"))
    assert [frame.step for frame in again] == list(range(30))
    np.testing.assert_array_equal(again[-1].belief.mean, RUN.frames[-1].belief.mean)


def test_a_folder_that_cannot_be_read_is_said(tmp_path: Path):
    with pytest.raises(ValueError, match="cannot be read"):
        zipped(tmp_path / "none")
