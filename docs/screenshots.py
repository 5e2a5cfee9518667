"""Take pictures of the dashboard: `make screenshots` writes them to runs/screenshots.

`--out` names another folder. Most pictures show a recorded run of this version at a step, in a
headless Chromium. They have each kind of network in four sizes of the window, dark and light, and
the cases behind the first repairs of the page. The others show a network that runs. `--data` is the
folder of recorded robots; without it, pictures of `mrclam` are left out.
"""

import argparse
import itertools
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from concord.dashboard.app import Dashboard
from concord.dashboard.frames.expected import Expectation, nothing_expected
from concord.dashboard.frames.live import LiveNetwork
from concord.dashboard.serve import open_network, open_recording
from concord.experiments.other_runs import expected, told_by
from concord.nodes.commands import in_words
from concord.runtime.batched.build import without_array_form
from concord.runtime.drivers import drive
from concord.runtime.interpreter import fresh_command, fresh_variables
from concord.runtime.network.control_client import Client
from concord.runtime.network.network_file import read_network
from concord.runtime.recording import McapRecorder
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import is_set_valued
from concord.scenarios.setup import Setup
from docs.shots import LIVE_SHOTS, SHOTS, LiveShot, Shot

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
_WAIT_S = 240.0
# Steps that a network has done before something is done to it.
_FIRST_STEPS = 20
_LIVE_SIZE = (1280, 800)


def main() -> None:
    """Take the named pictures, or all."""
    names = (*SHOTS, *LIVE_SHOTS)
    parser = argparse.ArgumentParser(prog="docs.screenshots", description=__doc__)
    parser.add_argument("names", nargs="*", help=f"any of {', '.join(names)}")
    parser.add_argument("--out", type=Path, default=Path("runs/screenshots"))
    parser.add_argument("--data", help="folder of the recorded robots of UTIAS, set 6")
    options = parser.parse_args()
    if unknown := set(options.names) - set(names):
        parser.error(f"{', '.join(sorted(unknown))}: choose from {', '.join(names)}")
    path = shutil.which("chromium")
    if path is None:
        parser.error("there is no chromium; `make browser` as root on Debian installs it")
    from playwright.sync_api import sync_playwright

    options.out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=path, args=[*_FLAGS])
        for name in options.names or names:
            file = options.out / f"{name}.png"
            if name in LIVE_SHOTS:
                _shoot_live(browser, LIVE_SHOTS[name], Path(folder) / name, file)
            elif SHOTS[name].scenario != "mrclam" or options.data is not None:
                _shoot_recorded(browser, SHOTS[name], Path(folder), options.data, file)
            sys.stderr.write(f"{file}\n")
        browser.close()


@cache
def _recorded(
    scenario: str, changes: str, folder: Path, data: str | None
) -> tuple[Setup, Path, Expectation]:
    """Return the setup of a run with these changes (JSON), its recording, and what is expected."""
    told = msgspec.json.decode(changes)
    if scenario == "mrclam":
        told["data"] = data
    setup = prepare(definition_named(scenario).defaults.with_(**told))
    file = Path(tempfile.mkdtemp(dir=folder)) / "run.mcap"
    recorder = McapRecorder(
        file, setup.scenario.rounds, setup.time_step_s, frame_format(setup.scenario)
    )
    drive(setup, recorder, lambda _: None)
    recorder.close()
    return setup, file, _expectation(setup)


def _expectation(setup: Setup) -> Expectation:
    """Return the expectation from other runs; an empty one if other runs would take minutes."""
    if is_set_valued(setup.scenario) or without_array_form(setup.scenario) is not None:
        return nothing_expected
    told = told_by(setup, 40 if setup.scenario.nodes < 100 else 20)
    return lambda times: expected(told, setup.time_step_s, times)


def _shoot_recorded(browser: Any, shot: Shot, folder: Path, data: str | None, file: Path) -> None:
    changes = msgspec.json.encode(shot.changes).decode()
    setup, recording, values = _recorded(shot.scenario, changes, folder, data)
    page = open_recording(setup, recording, "127.0.0.1", 0, shot.light, values)
    try:
        _shoot(browser, page, shot, file)
    finally:
        page.close()


def _shoot(browser: Any, page: Dashboard, shot: Shot, file: Path) -> None:
    view, clock_s = page.view, 1.0
    view.playing = view.follow = False
    while page.source.pace().state == "LOADING":
        clock_s += 1
        page.tick(clock_s)
    tab = _opened(browser, page, shot.size)
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
    _finish(tab, file)


def _opened(browser: Any, page: Dashboard, size: tuple[int, int]) -> Any:
    tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
    tab.set_default_timeout(1e3 * _WAIT_S)
    tab.goto(f"{page.url}&fixedDpr=1")
    tab.wait_for_function(_READY)
    return tab


def _finish(tab: Any, file: Path) -> None:
    # The letters of the scene come last.
    tab.wait_for_timeout(6000)
    tab.screenshot(path=str(file))
    tab.close()


def _shoot_live(browser: Any, shot: LiveShot, folder: Path, file: Path) -> None:
    with _network(shot.steps, folder) as process, ExitStack() as opened:
        client = _client(folder)
        opened.callback(client.close)
        clock_s = itertools.count(1.0)
        shown: list[tuple[Dashboard, Any]] = []

        def wait(holds: Callable[[], bool]) -> None:
            def drawn_holds() -> bool:
                for page, _ in shown:
                    page.tick(next(clock_s))
                return holds()

            _wait(drawn_holds)

        for act in shot.acts:
            if act == "wait":
                wait(lambda: client.state()["completed"] >= _FIRST_STEPS)
            elif act == "open":
                source = LiveNetwork(read_network(folder).connect, client.run)
                page = open_network(source, folder, "127.0.0.1", 0, light=False)
                opened.callback(page.close)
                shown.append((page, _opened(browser, page, _LIVE_SIZE)))
            elif act == "end":
                process.terminate()
            else:
                client.command(in_words(act.split()))
        ((page, tab),) = shown
        wait(lambda: page.source.pace().state == shot.state)
        for _ in range(20):
            page.tick(next(clock_s))
            tab.wait_for_timeout(100)
        tab.evaluate(_CLOSE)
        _finish(tab, file)


@contextmanager
def _network(steps: int, folder: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Start a network of eight processes, and end it."""
    options = ("--driver", "processes", "--nodes", "8", "--graph", "ring", "--steps", str(steps))
    command = fresh_command("concord.experiments", "run", *options, "--out", str(folder))
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(command, stdout=quiet, stderr=quiet, env=fresh_variables())
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def _client(folder: Path) -> Client:
    """Return a client of the network in a folder, as soon as that answers."""
    found: list[Client] = []

    def connects() -> bool:
        with suppress(OSError, ValueError):
            reach = read_network(folder)
            found.append(Client(reach.connect, reach.run))
        return bool(found) and found[-1].state()["begun"]

    _wait(connects)
    return found[-1]


def _wait(holds: Callable[[], bool]) -> None:
    until_s = time.monotonic() + _WAIT_S
    while not holds():
        if time.monotonic() > until_s:
            raise TimeoutError("a network has not come to the state of its picture")
        time.sleep(0.1)


if __name__ == "__main__":
    main()
