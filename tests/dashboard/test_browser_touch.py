"""Eight node processes whose picture is touched in a real browser: menus, drags, ghosts, script."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from concord.dashboard.frames.live import LiveNetwork
from concord.dashboard.serve import open_network
from concord.runtime.network.network_file import read_network
from tests.dashboard.browser_page import Page
from tests.processes import CONCORD, family, holds_within

pytestmark = pytest.mark.zenoh
ROOT = Path(__file__).resolve().parents[2]
NETWORK = ["--nodes", "8", "--graph", "ring", "--steps", "20000", "--seed", "3"]


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    folder = tmp_path_factory.mktemp("touched") / "run"
    command = (*CONCORD, "run", "--driver", "processes", *NETWORK, "--out", str(folder))
    with family(command, ROOT):
        assert holds_within(30.0, (folder / "network.json").exists)
        reach = read_network(folder)
        source = LiveNetwork(reach.connect, reach.run)
        assert holds_within(30.0, lambda: source.ask({"do": "pause"}).accepted)
        shown = Page(open_network(source, folder, "127.0.0.1", 0, light=False), chromium)
        shown.until(lambda: shown.text("run-state") == "PAUSED")
        yield shown
        shown.close()


def places(page: Page) -> np.ndarray:
    at = page.dashboard.page.scene.at
    assert at is not None
    return at


def free_node(page: Page) -> int:
    """Return a node that no panel covers and that stands apart from the others."""
    seen = np.array(page.pixels(places(page)))
    apart = np.linalg.norm(seen[:, None] - seen, axis=-1) + 999 * np.eye(len(seen))
    inside = np.all(np.abs(seen - [450, 240]) < [180, 190], axis=1)
    return int(np.argmax(np.where(inside, apart.min(axis=1), -1)))


def menu_on(page: Page, place: np.ndarray, word: str) -> None:
    """Open the menu at a point of the scene by the right button, and press a word in it."""
    page.page.evaluate(
        "()=>document.querySelectorAll('.mantine-Notification-closeButton').forEach(b=>b.click())"
    )
    page.page.mouse.click(*page.pixels(place[None])[0], button="right")
    menu = page.page.get_by_test_id("menu")
    page.until(lambda: menu.count() == 1 and menu.is_visible())
    menu.get_by_role("button", name=word, exact=True).click()
    page.until(lambda: menu.count() == 0)


def waiting(page: Page) -> str:
    """Return the changes that wait, in words; "" where none does."""
    return page.text("waiting") if page.page.get_by_test_id("waiting").count() else ""


def parts(page: Page, words: str) -> list[str]:
    return [name for name in page.scene() if name.startswith(words)]


def one_step(page: Page) -> None:
    step = int(page.text("step"))
    page.press("Step")
    page.until(lambda: int(page.text("step")) == step + 1)


def test_a_node_is_killed_by_its_menu_after_a_ghost_has_said_so(page: Page):
    node = free_node(page)
    menu_on(page, places(page)[node], "kill")
    page.until(lambda: f"kill node {node:02d}" in waiting(page))
    page.until(lambda: page.part("/pending/lines")["shown"] and bool(parts(page, "/pending/word")))
    assert page.part("/pending/word0")["text"] == "next step: kill"
    one_step(page)
    page.until(lambda: page.text("alive") == "7 / 8")
    page.until(lambda: not page.part("/pending/lines")["shown"])
    assert not parts(page, "/pending/word")
    menu_on(page, places(page)[node], "restart")
    one_step(page)
    page.until(lambda: page.text("alive") == "8 / 8" or one_step(page))


def far_link(page: Page) -> tuple[int, int]:
    """Return a link whose middle is in sight and away from all nodes."""
    at, edges = places(page), page.dashboard.stage.edges
    middles = at[edges].mean(axis=1)
    seen, nodes = np.array(page.pixels(middles)), np.array(page.pixels(at))
    apart = np.linalg.norm(seen[:, None] - nodes, axis=-1).min(axis=1)
    apart = np.minimum(apart, _to_others(seen))
    inside = np.all(np.abs(seen - [450, 240]) < [180, 190], axis=1)
    first, second = edges[np.argmax(np.where(inside, apart, -1))]
    return int(first), int(second)


def _to_others(seen: np.ndarray) -> np.ndarray:
    return (np.linalg.norm(seen[:, None] - seen, axis=-1) + 999 * np.eye(len(seen))).min(axis=1)


def test_a_link_is_cut_by_its_menu(page: Page):
    link = far_link(page)
    menu_on(page, places(page)[list(link)].mean(axis=0), "cut")
    page.until(lambda: "cut the link" in waiting(page))
    one_step(page)
    page.until(lambda: page.text("cut").startswith("1 /"))
    menu_on(page, places(page)[list(link)].mean(axis=0), "heal")
    one_step(page)
    page.until(lambda: page.text("cut").startswith("0 /"))


def open_link(page: Page) -> tuple[int, int]:
    """Return a link of which no panel covers either end."""
    seen, edges = np.array(page.pixels(places(page))), page.dashboard.stage.edges
    inside = np.all(np.abs(seen - [450, 240]) < [180, 190], axis=1)
    first, second = edges[inside[edges].all(axis=1)][0]
    return int(first), int(second)


def drag(page: Page, start: int, end: int) -> None:
    """Draw from a node to another at once: no picture shows the line on its way."""
    drag_to(page, start, page.pixels(places(page)[[end]])[0])


def drag_to(page: Page, node: int, pixel: tuple[float, float] | np.ndarray) -> None:
    page.page.mouse.move(*page.pixels(places(page)[[node]])[0])
    page.page.mouse.down()
    page.page.mouse.move(*pixel)
    page.page.mouse.up()


def test_a_link_that_is_drawn_is_cut_and_healed_when_it_is_drawn_again(page: Page):
    first, second = open_link(page)
    for words, state in (("cut the link", "1 /"), ("heal the link", "0 /")):
        drag(page, first, second)
        page.until(lambda words=words: words in waiting(page))
        one_step(page)
        page.until(lambda state=state: page.text("cut").startswith(state))
    assert not page.part("/pending/drawing")["shown"]


def strangers(page: Page) -> tuple[int, int]:
    """Return two nodes without a link that no panel covers."""
    seen, neighbours = np.array(page.pixels(places(page))), page.dashboard.stage.setup.neighbours
    inside = np.flatnonzero(np.all(np.abs(seen - [450, 240]) < [180, 190], axis=1)).tolist()
    pairs = ((i, j) for i in inside for j in inside if i < j and j not in neighbours[i])
    return next(pairs)


def test_a_link_that_the_network_lacks_is_there_after_it_was_drawn(page: Page):
    first, second = strangers(page)
    drag(page, first, second)
    page.until(lambda: "graph" in waiting(page))
    page.until(lambda: page.part("/pending/lines")["shown"])
    assert page.text("cut") == "0 / 8"
    one_step(page)
    page.until(lambda: page.text("cut") == "0 / 9")
    assert second in page.dashboard.stage.setup.neighbours[first]
    one_step(page)
    drag(page, first, second)
    page.until(lambda: "cut the link" in waiting(page))
    one_step(page)
    page.until(lambda: page.text("cut") == "1 / 9")
    # Nodes that miss frames over a link that came later do not stop the picture.
    assert page.page.get_by_test_id("failure").count() == 0


def test_a_node_that_is_dragged_stands_where_it_was_let_go(page: Page):
    node, _ = strangers(page)
    before, pixel = page.dashboard.stage.positions(0), _free_ground(page, node)
    drag_to(page, node, pixel)
    page.until(lambda: "placement" in waiting(page))
    page.until(lambda: page.part("/pending/lines")["shown"])
    assert np.array_equal(page.dashboard.stage.positions(0), before)
    one_step(page)
    page.until(lambda: not np.array_equal(page.dashboard.stage.positions(0), before))
    after = page.dashboard.stage.positions(0)
    assert np.flatnonzero((after != before).any(axis=1)).tolist() == [node]
    page.until(lambda: np.abs(page.pixels(places(page)[[node]])[0] - pixel).max() < 4)


def _free_ground(page: Page, node: int) -> np.ndarray:
    """Return the nearest pixel to a node that is far from all nodes, and not under a panel."""
    seen = np.array(page.pixels(places(page)))
    turns = np.linspace(0, 2 * np.pi, 24)
    around = seen[node] + 60 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    clear = np.linalg.norm(around[:, None] - seen, axis=-1).min(axis=1)
    inside = np.all(np.abs(around - [450, 240]) < [200, 200], axis=1)
    return around[np.argmax(np.where(inside, clear, 0))]


def test_the_session_is_a_script_that_can_be_copied(page: Page):
    page.page.get_by_role("tab", name="Log", exact=True).click()
    page.until(lambda: page.page.get_by_test_id("script").is_visible())
    script = page.text("script")
    for words in (" kill ", " restart ", " cut ", " heal ", " set graph=edges:", "placement=at:"):
        assert words in script
    assert script.startswith('--changes "')
    page.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.page.get_by_test_id("copy").click()
    told = page.page.wait_for_function("() => navigator.clipboard.readText()").json_value()
    assert told == script


def test_the_console_is_clean(page: Page):
    assert page.console == []
