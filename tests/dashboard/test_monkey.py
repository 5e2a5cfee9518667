"""Random clicks, seeded, on every control of a page: it goes on, and no panel fails.

`python -m tests.dashboard.test_monkey SECONDS` clicks for longer, on three runs in turn, or with
`live` after the seconds on three networks that run.
"""

import random
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from concord.dashboard.frames.live import LiveNetwork
from concord.dashboard.serve import open_network
from concord.runtime.network.control_client import Client, NotThere
from concord.runtime.network.network_file import read_network
from tests.dashboard.browser_page import Page, recorded_page, row_of
from tests.processes import CONCORD, PATIENCE_S, family, holds_within

SEED, ACTIONS = 20, 30
TABS = ("Charts", "One state", "Log", "Nodes", "Selected", "Help", "Beliefs", "States")
BUTTONS = ("Resume", "Pause", "Step", "Go to the end", "Fit")
BOXES = ("Dark", "Follow target", "Sight lines", "Sensing range", "Names")
COMMANDS = ("kill", "restart", "cut", "heal", "Apply at the next step")
CLICKED = {"button": BUTTONS, "tab": TABS, "box": BOXES, "command": COMMANDS}
LISTS = {"Ellipses": ("selected", "all", "none"), "Table by": ("number", "error", "age")}
RUNS: tuple[dict[str, Any], ...] = (
    {"nodes": 8, "changes": ("10 kill 6", "14 set occupancy=0.5 schedule=hybrid")},
    {"nodes": 12, "changes": ("5 loss 0.3", "12 lie 3 5 4", "20 set rounds=5 rule=hcmci")},
    {"nodes": 24, "changes": ("8 corrupt 0.3", "15 kill 3", "25 restart 3")},
)
NETWORKS = (
    ("--nodes", "8"),
    ("--nodes", "12", "--schedule", "hybrid", "--occupancy", "0.5"),
    ("--scenario", "target-swarm", "--nodes", "5", "--targets", "3"),
)
FAULTS = ("corrupt 0.05", "hang 3 2", "lie 1 5 4", "lie 1 0 1", "loss 0.2", "calm", "fly 7")
STEPS_PER_S = 10.0


class Monkey:
    """Does one random thing after the other to a page."""

    def __init__(self, page: Page, seed: int) -> None:
        self._page, self._choose = page, random.Random(seed)
        self._kinds = ["button", "tab", "box", "key", "row", "step", "list", "drag", "size"]
        if page.dashboard.source.live:
            self._kinds += ["command", "fault"]
        self.done: list[str] = []

    def act(self) -> None:
        """Do one thing; a control that is not there is passed over."""
        choose, page = self._choose, self._page
        kind = choose.choice(self._kinds)
        what = ""
        match kind:
            case "button" | "tab" | "box" | "command":
                what = choose.choice(CLICKED[kind])
                self._click(kind, what)
            case "fault":
                what = choose.choice(FAULTS)
                self._inject(what)
            case "key":
                what = choose.choice("pngjkxd")
                page.key(what)
            case "row":
                what = str(choose.randrange(page.dashboard.stage.nodes))
                self._event(page.page.locator(row_of(int(what))), "pointerdown")
            case "step":
                what = str(choose.randrange(-3, 40))
                page.dashboard.inputs.alter(lambda view: view.look_at(int(what)))
            case "list":
                what = choose.choice(tuple(LISTS))
                if page.widget(what).locator("input").first.is_visible():
                    page.choose(what, choose.choice(LISTS[what]))
            case "drag":
                x, y = choose.randrange(300, 700), choose.randrange(60, 400)
                page.page.mouse.move(x, y)
                page.page.mouse.down()
                page.page.mouse.move(x + choose.randrange(-80, 80), y + choose.randrange(-80, 80))
                page.page.mouse.up()
            case "size":
                width = choose.choice((1280, 1366, 1600))
                page.page.set_viewport_size({"width": width, "height": 720})
        self.done.append(f"{kind} {what}")
        for _ in range(choose.randrange(1, 4)):
            page.draw()
        page.page.wait_for_timeout(choose.randrange(10, 120))

    def _inject(self, words: str) -> None:
        field = self._page.widget("Fault").locator("input").first
        if field.is_visible():
            field.fill(words)
            self._click("fault", "Inject")

    def _click(self, kind: str, what: str) -> None:
        page = self._page.page
        if kind == "box":
            target = self._page.widget(what).locator("input")
        elif kind == "tab":
            target = page.get_by_text(what, exact=True)
        else:
            target = page.get_by_role("button", name=what, exact=True)
        self._event(target, "click")

    def _event(self, target: Any, event: str) -> None:
        """Do it to the first such element that is there now.

        A locator would wait for an element whose name has just changed, as Pause does to Resume at
        the end of a recording, and nothing draws the page while it waits.
        """
        for element in target.element_handles()[:1]:
            if element.is_visible():
                element.dispatch_event(event)


def torment(page: Page, seed: int, least: int, seconds: float = 0.0) -> int:
    """Let a monkey do so many things to a page at least, for so long; return how many it did.

    Raises:
        AssertionError: a panel failed, the console told of an error, or the page is dead.
    """
    monkey = Monkey(page, seed)
    end_s = time.monotonic() + seconds
    while len(monkey.done) < least or time.monotonic() < end_s:
        monkey.act()
        failed = page.dashboard.failures.sentences()
        assert not failed, (failed, monkey.done[-20:])
    # The page still does what it is asked to.
    step = page.dashboard.history.first_step + 5
    page.dashboard.inputs.alter(lambda view: view.look_at(step))
    page.until(lambda: page.text("step") == str(step))
    assert page.console == [], monkey.done[-20:]
    return len(monkey.done)


@contextmanager
def network_page(browser: Any, folder: Path, options: tuple[str, ...]) -> Iterator[Page]:
    """Start a network of processes with these options; yield a page on it."""
    command = (*CONCORD, "run", "--driver", "processes", "--steps", "8000", *options)
    with family((*command, "--out", str(folder)), folder.parent):
        source = _connected(folder)
        slowed = {"do": "speed", "steps_per_second": STEPS_PER_S}
        assert holds_within(PATIENCE_S, lambda: source.ask(slowed).accepted)
        page = Page(open_network(source, folder, "127.0.0.1", 0, light=False), browser)
        try:
            page.until(lambda: page.dashboard.history.last_step >= 8)
            yield page
        finally:
            page.close()


def _connected(folder: Path) -> LiveNetwork:
    """Connect to a network; its environment draws all its randomness before it answers."""
    source: LiveNetwork | None = None

    def connect() -> bool:
        nonlocal source
        with suppress(NotThere):
            reach = read_network(folder)
            source = LiveNetwork(reach.connect, reach.run)
        return source is not None

    assert holds_within(PATIENCE_S, (folder / "network.json").exists)
    assert holds_within(PATIENCE_S, connect)
    assert source is not None
    return source


def torment_network(
    browser: Any, folder: Path, options: tuple[str, ...], seed: int, least: int, seconds: float = 0
) -> int:
    """Let a monkey at the page of a network that runs, as `torment` does.

    Raises:
        AssertionError: as `torment` does; or the network is paused, and the page does not say so.
    """
    with network_page(browser, folder, options) as page:
        done = torment(page, seed, least, seconds)
        reach = read_network(folder)
        onlooker = Client(reach.connect, reach.run)
        try:
            if onlooker.state()["paused"]:
                page.until(lambda: page.text("run-state") == "PAUSED")
                page.press("Resume")
            page.until(lambda: page.text("run-state") == "RUNNING")
            last = page.dashboard.history.last_step
            page.until(lambda: page.dashboard.history.last_step > last)
        finally:
            onlooker.close()
    return done


@pytest.mark.parametrize("number", [0, pytest.param(1, marks=pytest.mark.study)])
def test_random_clicks_leave_the_page_alive(chromium, tmp_path: Path, number: int):
    page = recorded_page(chromium, tmp_path, steps=36, **RUNS[number])
    try:
        torment(page, SEED + number, ACTIONS)
    finally:
        page.close()


@pytest.mark.zenoh
@pytest.mark.slow
def test_random_clicks_leave_a_network_and_its_page_alive(chromium, tmp_path: Path):
    torment_network(chromium, tmp_path / "run", NETWORKS[0], SEED, ACTIONS)


def main() -> None:
    """Torment a page of each run for a third of the seconds that the command line names."""
    from playwright.sync_api import sync_playwright

    from tests.dashboard.conftest import FLAGS, browser_path

    seconds, is_live = float(sys.argv[1]) / len(RUNS), sys.argv[2:] == ["live"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path(), args=[*FLAGS])
        for number, (changes, options) in enumerate(zip(RUNS, NETWORKS, strict=True)):
            with tempfile.TemporaryDirectory() as name:
                folder, seed = Path(name), SEED + number
                if is_live:
                    done = torment_network(browser, folder / "run", options, seed, 0, seconds)
                else:
                    page = recorded_page(browser, folder, steps=36, **changes)
                    done = torment(page, seed, 0, seconds)
                    page.close()
            sys.stdout.write(f"run {number}: {done} actions, no failure\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
