"""Random clicks, seeded, on every control of a page: it goes on, and no panel fails.

`python -m tests.dashboard.test_monkey SECONDS` clicks for longer, on three runs in turn.
"""

import random
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from tests.dashboard.browser_page import Page, recorded_page, row_of

SEED, SECONDS = 20, 12.0
TABS = ("Charts", "One state", "Log", "Nodes", "Selected", "Help", "Beliefs", "States")
BUTTONS = ("Resume", "Pause", "Step", "Go to the end", "Fit")
BOXES = ("Dark", "Follow target", "Sight lines", "Sensing range", "Names")
LISTS = {"Ellipses": ("selected", "all", "none"), "Table by": ("number", "error", "age")}
RUNS: tuple[dict[str, Any], ...] = (
    {"nodes": 8, "changes": ("10 kill 6", "14 set occupancy=0.5 schedule=hybrid")},
    {"nodes": 12, "changes": ("5 loss 0.3", "12 lie 3 5 4", "20 set rounds=5 rule=hcmci")},
    {"nodes": 24, "changes": ("8 corrupt 0.3", "15 kill 3", "25 restart 3")},
)


class Monkey:
    """Does one random thing after the other to a page."""

    def __init__(self, page: Page, seed: int) -> None:
        self._page, self._choose = page, random.Random(seed)
        self.done: list[str] = []

    def act(self) -> None:
        """Do one thing; a control that is not there is passed over."""
        choose, page = self._choose, self._page
        kind = choose.choice(("button", "tab", "box", "key", "row", "step", "list", "drag", "size"))
        what = ""
        match kind:
            case "button" | "tab" | "box":
                what = choose.choice({"button": BUTTONS, "tab": TABS, "box": BOXES}[kind])
                self._click(kind, what)
            case "key":
                what = choose.choice("pngjkxd")
                page.key(what)
            case "row":
                what = str(choose.randrange(page.dashboard.stage.nodes))
                row = page.page.locator(row_of(int(what)))
                if row.count():
                    row.first.dispatch_event("pointerdown")
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

    def _click(self, kind: str, what: str) -> None:
        page = self._page.page
        if kind == "box":
            target = self._page.widget(what).locator("input").first
        elif kind == "tab":
            target = page.get_by_text(what, exact=True).first
        else:
            target = page.get_by_role("button", name=what, exact=True).first
        if target.count() and target.is_visible():
            target.dispatch_event("click")


def torment(browser: Any, folder: Path, changes: dict[str, Any], seed: int, seconds: float) -> int:
    """Let a monkey at a page for so long; return how many things it did.

    Raises:
        AssertionError: a panel failed, the console told of an error, or the page is dead.
    """
    page = recorded_page(browser, folder, steps=36, **changes)
    monkey = Monkey(page, seed)
    try:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            monkey.act()
            failed = page.dashboard.failures.sentences()
            assert not failed, (failed, monkey.done[-20:])
        # The page still does what it is asked to.
        page.dashboard.inputs.alter(lambda view: view.look_at(17))
        page.until(lambda: page.text("step") == "17")
        assert page.console == [], monkey.done[-20:]
    finally:
        page.close()
    return len(monkey.done)


@pytest.mark.parametrize("number", [0, 1])
def test_random_clicks_leave_the_page_alive(chromium, tmp_path: Path, number: int):
    assert torment(chromium, tmp_path, RUNS[number], SEED + number, SECONDS) > 5


def main() -> None:
    """Torment a page of each run for a third of the seconds that the command line names."""
    from playwright.sync_api import sync_playwright

    from tests.dashboard.conftest import FLAGS, browser_path

    seconds = float(sys.argv[1]) / len(RUNS)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path(), args=[*FLAGS])
        for number, changes in enumerate(RUNS):
            with tempfile.TemporaryDirectory() as folder:
                done = torment(browser, Path(folder), changes, SEED + number, seconds)
            sys.stdout.write(f"run {number}: {done} actions, no failure\n")


if __name__ == "__main__":
    main()
