"""Take pictures of the dashboard: `make screenshots` writes them to runs/screenshots.

`--out` names another folder. Each picture shows a recorded run of this version at a step, in a
headless Chromium.
"""

import argparse
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from concord.dashboard.app import Dashboard
from concord.dashboard.frames.expected import Expectation, nothing_expected
from concord.dashboard.serve import open_recording
from concord.experiments.monte_carlo.other_runs import expected, told_by
from concord.runtime.batched.build import without_array_form
from concord.runtime.drivers import drive
from concord.runtime.recording import McapRecorder
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.rules import is_set_valued
from concord.scenarios.setup import Setup
from concord.scenarios.types.frame_formats import frame_format

_FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
)
_READY = (
    "()=>window.__viserTestpoints && window.__viserTestpoints.rendererInfo"
    " && window.__viserTestpoints.rendererInfo.render.frame>2"
)
_CLOSE = "()=>document.querySelectorAll('.mantine-Notification-closeButton').forEach(b=>b.click())"


class Shot(NamedTuple):
    """One picture: the scenario with its changes, the step, and the selection on the page."""

    scenario: str
    changes: dict[str, Any]
    step: int
    view: dict[str, Any]
    light: bool = False
    size: tuple[int, int] = (1600, 900)
    tab: str | None = None


_HYBRID = {"schedule": "hybrid", "occupancy": 0.5}
SHOTS = {
    "dark": Shot("target-tracking", {"nodes": 16, "steps": 90, **_HYBRID}, 78, {"selected": 7}),
    "light": Shot(
        "target-tracking", {"nodes": 16, "steps": 90, **_HYBRID}, 78, {"selected": 7}, light=True
    ),
    "24-nodes": Shot("target-tracking", {"nodes": 24, "steps": 90, **_HYBRID}, 60, {"selected": 5}),
    "200-nodes": Shot(
        "target-tracking",
        {"nodes": 200, "steps": 45, "schedule": "hybrid", "occupancy": 0.1},
        44,
        {"selected": 21},
    ),
    "targets": Shot("target-swarm", {"targets": 10}, 70, {"selected": 4}, size=(1366, 768)),
    "8-nodes": Shot("target-tracking", {"nodes": 8, "steps": 60}, 50, {}, size=(800, 600)),
    "phone": Shot("target-tracking", {"nodes": 8, "steps": 60}, 50, {}, size=(390, 844)),
    "100-nodes": Shot(
        "target-tracking", {"nodes": 100, "steps": 40, "schedule": "hybrid", "occupancy": 0.1}, 39,
        {"selected": 21}, light=True, size=(1280, 800),
    ),
    "vehicle": Shot("vehicle-network", {"steps": 700}, 690, {"selected": 1}),
    "replay": Shot(
        "oscillator", {"nodes": 12, "steps": 80, "graph": "small-world"}, 40, {"selected": 4},
        light=True, size=(1280, 720),
    ),
    "400-nodes": Shot(
        "target-tracking",
        {"nodes": 400, "steps": 40, "graph": "4-regular", "schedule": "hybrid", "occupancy": 0.05},
        39,
        {"selected": 21},
        size=(1920, 1080),
    ),
    "sets": Shot(
        "liu2021-network", {"steps": 60, "rule": "zonotope"}, 40, {"selected": 2},
        size=(1920, 1080), tab="Beliefs",
    ),
}  # fmt: skip


def main() -> None:
    """Take the named pictures, or all."""
    parser = argparse.ArgumentParser(prog="docs.screenshots", description=__doc__)
    parser.add_argument("names", nargs="*", help=f"any of {', '.join(SHOTS)}")
    parser.add_argument("--out", type=Path, default=Path("runs/screenshots"))
    options = parser.parse_args()
    if unknown := set(options.names) - set(SHOTS):
        parser.error(f"{', '.join(sorted(unknown))}: choose from {', '.join(SHOTS)}")
    path = shutil.which("chromium")
    if path is None:
        parser.error("there is no chromium; `make browser` as root on Debian installs it")
    from playwright.sync_api import sync_playwright

    options.out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*_FLAGS])
        for name in options.names or SHOTS:
            file = options.out / f"{name}.png"
            _take(browser, SHOTS[name], file)
            sys.stderr.write(f"{file}\n")
        browser.close()


def _take(browser: Any, shot: Shot, file: Path) -> None:
    setup = prepare(definition_named(shot.scenario).defaults.with_(**shot.changes))
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.mcap"
        recorder = McapRecorder(
            recording, setup.scenario.rounds, setup.time_step_s, frame_format(setup.scenario)
        )
        drive(setup, recorder, lambda _: None)
        recorder.close()
        page = open_recording(setup, recording, "127.0.0.1", 0, shot.light, _expectation(setup))
        try:
            _shoot(browser, page, shot, file)
        finally:
            page.close()


def _expectation(setup: Setup) -> Expectation:
    """Return the expectation from other runs; an empty one if other runs would take minutes."""
    if is_set_valued(setup.scenario) or without_array_form(setup.scenario) is not None:
        return nothing_expected
    told = told_by(setup, 40 if setup.scenario.nodes < 100 else 20)
    return lambda times: expected(told, setup.time_step_s, times)


def _shoot(browser: Any, page: Dashboard, shot: Shot, file: Path) -> None:
    view, clock_s = page.view, 1.0
    view.playing = view.follow = False
    while page.source.pace().state == "LOADING":
        clock_s += 1
        page.tick(clock_s)
    width, height = shot.size
    tab = browser.new_page(viewport={"width": width, "height": height})
    tab.goto(f"{page.url}&fixedDpr=1")
    tab.wait_for_function(_READY, timeout=60_000)
    for name, value in shot.view.items():
        setattr(view, name, value)
    for _ in range(5):
        # The same moment of the bus in every picture.
        view.step, view.cursor = shot.step, 0.5 * len(page.history.at(shot.step).cycles)
        page.inputs.select(view.selected)
        clock_s += 0.3
        page.tick(clock_s)
        tab.wait_for_timeout(400)
    if shot.tab:
        tab.get_by_text(shot.tab, exact=True).first.click()
    tab.evaluate(_CLOSE)
    tab.wait_for_timeout(2500)
    tab.screenshot(path=str(file))
    tab.close()


if __name__ == "__main__":
    main()
