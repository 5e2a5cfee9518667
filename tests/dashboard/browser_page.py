"""A page under test: a dashboard in this process, stepped by hand, and its browser."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.dashboard.app import Dashboard
from concord.dashboard.serve import open_recording
from concord.runtime.drivers import drive
from concord.runtime.recording import McapRecorder
from concord.scenarios.setup import Setup
from tests.dashboard.browser_tab import new_tab
from tests.dashboard.runs import setup_of
from tests.processes import PATIENCE_S, holds_within

_READY = (
    "()=>window.__viserTestpoints && window.__viserTestpoints.rendererInfo"
    " && window.__viserTestpoints.rendererInfo.render.frame>2"
)
_SCENE = "()=>Object.keys(window.__viserSceneTree.getState())"
_PART = (
    "name=>{const part=window.__viserSceneTree.getState()[name];"
    "const props=Object.entries(part.message.props).map(([key,value])=>"
    "[key,ArrayBuffer.isView(value)?Array.from(value):value]);"
    "return {shown:part.visibility,...Object.fromEntries(props)}}"
)
_CHARTS = "()=>Object.values(window.__viserTestpoints.uplots).map(u=>u.chart.data[0].length)"
_CLOSE = "()=>document.querySelectorAll('.mantine-Notification-closeButton').forEach(b=>b.click())"
# A notice goes after three seconds, and a slow test may look too late.
_KEEP_NOTICES = (
    "{const told=window.__notices=new Set();new MutationObserver(()=>"
    "document.querySelectorAll('.mantine-Notification-root').forEach(n=>told.add(n.textContent)))"
    ".observe(document,{childList:true,subtree:true,characterData:true})}"
)
# The middle of an element that stood still for half a second, or after two seconds where it moves.
_MIDDLE = (
    "selector=>{const box=document.querySelector(selector)?.getBoundingClientRect();"
    "if(!box?.width)return null;const at=[box.x+box.width/2,box.y+box.height/2];"
    "let was=window.stood;if(was?.selector!==selector)was={selector,polls:0,still:0,at:[-1,-1]};"
    "was.still=Math.hypot(at[0]-was.at[0],at[1]-was.at[1])<0.5?was.still+1:0;was.at=at;was.polls++;"
    "const done=was.still>9||was.polls>40;window.stood=done?null:was;return done?at:null}"
)
# One in three pages says so when the pointer passes a batched mesh, and each at a drag; nothing is
# wrong on screen.
_HARMLESS = (
    "glDrawElementsInstanced", "GPU stall", "THREE.Clock", "GL Driver Message",
    "preventDefault inside passive",
)  # fmt: skip


def row_of(node: int) -> str:
    """The row of a node in the table, as a selector."""
    return f'[data-testid="nodes"] tr[data-node="{node}"]'


def slot_of(node: int) -> str:
    """The frame of a node in the shown cycle of the bus."""
    return f'[data-testid="timeline"] .slot[data-node="{node}"]'


def press_on(page: Any, selector: str) -> None:
    """Press where an element is now, as a hand does: it need not be there after.

    Playwright's own click waits for an element that lasts, and ours are replaced with each picture.
    """
    page.mouse.click(*_middle(page, selector))


def point_at(page: Any, selector: str) -> None:
    """Move the pointer to where an element is now."""
    page.mouse.move(*_middle(page, selector))


def _middle(page: Any, selector: str) -> list[float]:
    """Where the middle of an element is, as soon as it stands still: a tab may be opening."""
    return page.wait_for_function(_MIDDLE, arg=selector, polling=50).json_value()


def recorded(folder: Path, **changes: Any) -> tuple[Setup, Path]:
    """Run target-tracking with these settings; return its setup and its recording."""
    setup = setup_of("target-tracking", **changes)
    file = folder / "run.mcap"
    recorder = McapRecorder(file, setup.scenario.rounds, setup.time_step_s, SHARE_FRAMES)
    drive(setup, recorder, lambda _: None)
    recorder.close()
    return setup, file


def recorded_page(browser: Any, folder: Path, light: bool = False, **changes: Any) -> "Page":
    """Run target-tracking with these settings; return a page at rest on its recording."""
    setup, file = recorded(folder, **changes)
    (folder / "run.json").write_text("{}")
    dashboard = open_recording(setup, file, "127.0.0.1", 0, light)
    dashboard.view.playing = dashboard.view.follow = False
    return Page(dashboard, browser)


class Page:
    """The dashboard and its page; `clock` is the dashboard's only time."""

    def __init__(self, dashboard: Dashboard, browser: Any, open_folders: bool = True) -> None:
        self.dashboard = dashboard
        self.clock_s = 1.0
        self.console: list[str] = []
        assert holds_within(PATIENCE_S, self._loaded), "the recording never loaded"
        self.page = new_tab(browser)
        self.page.add_init_script(_KEEP_NOTICES)
        self.page.on("console", self._listen)
        self.page.on("pageerror", lambda error: self.console.append(f"error: {error}"))
        self.page.goto(f"{dashboard.url}&fixedDpr=0.5")
        self.page.wait_for_function(_READY)
        self.until(lambda: self.page.get_by_test_id("nodes").count() == 1)
        if open_folders:
            self.open_folders()

    def open_folders(self) -> None:
        """Open the folders that a page begins with closed."""
        for name in ("View", "Export", "Network", "Node and link"):
            for folder in self.page.get_by_text(name, exact=True).all():
                folder.click()

    def _loaded(self) -> bool:
        self.draw()
        return self.dashboard.source.pace().state != "LOADING"

    def _listen(self, message: Any) -> None:
        if message.type in ("error", "warning") and not any(h in message.text for h in _HARMLESS):
            self.console.append(f"{message.type}: {message.text}")

    def has_told(self, words: str) -> bool:
        """Whether a notice with these words has ever been on the page."""
        return any(words in one for one in self.page.evaluate("()=>[...window.__notices]"))

    def draw(self) -> None:
        """One turn of the dashboard's loop, late enough that everything is due."""
        self.clock_s += 1.0
        self.dashboard.tick(self.clock_s)

    def until(self, holds: Callable[[], bool | None], seconds: float = PATIENCE_S) -> None:
        """Draw until something holds on the page."""

        def drawn_holds() -> bool | None:
            self.draw()
            return holds()

        came = holds_within(seconds, drawn_holds, lambda: self.page.wait_for_timeout(60))
        assert came, "it never came to hold"

    def text(self, name: str) -> str:
        """The text of one of our own elements."""
        return self.page.get_by_test_id(name).first.text_content() or ""

    def press(self, name: str) -> None:
        """Press a button by its words."""
        self.page.evaluate(_CLOSE)
        self.page.get_by_role("button", name=name, exact=True).first.click()

    def row(self, node: int) -> Any:
        """A row of the table of nodes."""
        return self.page.locator(row_of(node))

    def scene(self) -> list[str]:
        """Names of what is in the scene."""
        return self.page.evaluate(_SCENE)

    def part(self, name: str) -> dict[str, Any]:
        """Return the browser's view of a part of the scene: its properties and its visibility.

        Arrays are flat lists.
        """
        return self.page.evaluate(_PART, name)

    def chart_points(self) -> list[int]:
        """How many points each chart shows."""
        return self.page.evaluate(_CHARTS)

    def choose(self, label: str, option: str) -> None:
        """Choose from a dropdown."""
        self.widget(label).locator("input").first.click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def widget(self, label: str) -> Any:
        """The row of a widget by its label."""
        found = self.page.locator("label").get_by_text(label, exact=True)
        return self.page.locator(".mantine-Flex-root", has=found).last

    def enter(self, label: str, value: float) -> None:
        """Enter a number into a field or beside a slider."""
        self.widget(label).locator("input[type=text], input[inputmode]").last.fill(f"{value:g}")

    def chosen(self, label: str) -> str:
        """Return the text that a dropdown shows."""
        return self.widget(label).locator("input").first.input_value()

    def download(self, button: str, seconds: float = 30.0) -> bytes:
        """Press a button and return the file that it offers for download."""
        self.page.evaluate(_CLOSE)
        got: list[Any] = []
        self.page.once("download", lambda download: got.append(download))
        self.page.get_by_role("button", name=button, exact=True).click()
        self.until(lambda: bool(got), seconds)
        return Path(got[0].path()).read_bytes()

    def key(self, key: str) -> None:
        """Press a key while no field has the focus: keys are shortcuts only then."""
        self.page.evaluate("()=>document.activeElement.blur()")
        self.page.keyboard.press(key)

    def pixels(self, places: np.ndarray) -> list[tuple[float, float]]:
        """Where points of the scene (P, 3) are on the screen."""
        client = next(iter(self.dashboard.server.get_clients().values()))
        canvas = self.page.locator("canvas").first.bounding_box()
        return [_pixel(client.camera, place, canvas) for place in places]

    def close(self) -> None:
        """End both."""
        self.page.close()
        self.dashboard.close()


def _pixel(camera, place: np.ndarray, canvas: dict[str, float]) -> tuple[float, float]:
    """Where a point of the scene is on the screen: a pinhole camera that looks along z."""
    w, x, y, z = camera.wxyz
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    right, down, ahead = turn.T @ (place - camera.position)
    focal = canvas["height"] / 2 / np.tan(camera.fov / 2)
    return (
        float(canvas["x"] + canvas["width"] / 2 + focal * right / ahead),
        float(canvas["y"] + canvas["height"] / 2 + focal * down / ahead),
    )
