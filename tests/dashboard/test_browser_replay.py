"""A recorded run in a real browser: what is drawn, what the pointer and the buttons do."""

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from matplotlib.image import imread

from tests.dashboard.browser_page import Page, point_at, press_on, recorded_page, row_of, slot_of

# One after the other: a node that is pressed, and then where the pointer is.
_PRESS_AND_MOVE_ON = """([first, second, third]) => {
    const says = (node, type) => document.querySelector(
        `[data-testid="timeline"] .slot[data-node="${node}"]`
    ).dispatchEvent(new PointerEvent(type, {bubbles: true}));
    says(first, 'pointerover');
    says(second, 'pointerdown');
    says(third, 'pointerover');
}"""


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    folder = tmp_path_factory.mktemp("recorded")
    shown = recorded_page(chromium, folder, nodes=8, steps=40, schedule="hybrid", occupancy=0.5)
    yield shown
    shown.close()


@pytest.fixture(autouse=True)
def _begin(page: Page) -> None:
    """At rest in the last cycle of step 30, with nothing selected, the pointer nowhere."""
    page.page.mouse.move(400, 20)
    dashboard = page.dashboard
    dashboard.inputs.alter(lambda view: view.look_at(30))
    dashboard.inputs.alter(lambda view: setattr(view, "cursor", dashboard.stage.rounds - 0.35))
    dashboard.inputs.alter(lambda view: setattr(view, "hovered", None))
    dashboard.inputs.select(None)
    page.until(lambda: page.text("step") == "30" and not page.part("/network/selected")["shown"])
    last = dashboard.history.at(30).cycles[-1].bus_cycle
    page.until(lambda: page.text("bus-cycle") == str(last))


def nodes_on_the_bus(page: Page) -> list[int]:
    slots = page.page.locator('[data-testid="timeline"] .slot')
    return [int(slot.get_attribute("data-node") or -1) for slot in slots.all()]


def is_marked(page: Page, node: int) -> bool:
    """Whether the row of a node in the table has a ground of its own."""
    return "background" in (page.row(node).get_attribute("style") or "")


def is_selected(page: Page, node: int) -> bool:
    """In the table and in the scene alike, and no other."""
    return (
        page.dashboard.view.selected == node
        and is_marked(page, node)
        and page.part("/network/selected")["shown"]
        and not any(is_marked(page, other) for other in range(8) if other != node)
    )


def test_the_scene_has_its_parts_and_is_rendered(page: Page):
    parts = set(page.scene())
    for part in ("/network/nodes", "/network/links", "/plant/truth", "/plant/estimates"):
        assert part in parts
    picture = page.page.screenshot(clip={"x": 260, "y": 10, "width": 420, "height": 440})
    from matplotlib.image import imread

    pixels = imread(io.BytesIO(picture))[..., :3]
    assert len(np.unique((255 * pixels).astype(int).reshape(-1, 3), axis=0)) > 50


def test_charts_have_data(page: Page):
    page.until(lambda: len(page.chart_points()) >= 4 and min(page.chart_points()[:4]) > 5)


def test_the_strip_shows_the_whole_run_and_a_press_on_it_seeks(page: Page):
    bins = page.page.locator('[data-testid="run"] .bin')
    assert bins.count() == 40
    rmse = f"{page.dashboard.history.at(12).scores.rmse:.3g} m"
    assert bins.nth(12).text_content().splitlines()[:2] == ["step 12", f"RMSE {rmse}"]
    for step in (12, 39, 0):
        press_on(page.page, f'[data-testid="run"] .bin[data-node="{step}"]')
        page.until(lambda step=step: page.text("step") == str(step))
        assert page.dashboard.history.last_step == 39

    def cursor() -> float:
        path = page.page.get_by_test_id("run-cursor").get_attribute("d") or ""
        return float(path[1:].split()[0])

    left = cursor()
    press_on(page.page, '[data-testid="run"] .bin[data-node="20"]')
    page.until(lambda: cursor() > left + 300)
    page.key("b")
    page.until(lambda: page.text("step") == "19")


@pytest.fixture
def _slowly(page: Page) -> Iterator[None]:
    """Play so slowly that a recording does not end before a busy browser shows that it plays."""
    page.dashboard.inputs.alter(lambda view: setattr(view, "speed", 0.25))
    yield
    page.dashboard.inputs.alter(lambda view: setattr(view, "speed", 1.0))


@pytest.mark.usefixtures("_slowly")
def test_pause_and_resume(page: Page):
    page.press("Resume")
    page.until(lambda: page.text("mode") == "playing")
    page.until(lambda: int(page.text("step")) > 31)
    page.press("Pause")
    page.until(lambda: page.text("mode") == "paused")
    step = page.text("step")
    for _ in range(3):
        page.draw()
    assert page.text("step") == step


@pytest.mark.usefixtures("_slowly")
def test_the_end_is_reached_while_the_recording_plays_and_resume_begins_again(page: Page):
    for go in (lambda: page.press("Go to the end"), lambda: page.key("g")):
        page.dashboard.inputs.alter(lambda view: view.look_at(5))
        page.press("Resume")
        page.until(lambda: page.text("mode") == "playing")
        go()
        page.until(lambda: page.text("step") == "39" and page.text("mode") == "paused")
    page.press("Resume")
    page.until(lambda: page.text("mode") == "playing" and int(page.text("step")) < 39)
    page.press("Pause")
    page.until(lambda: page.text("mode") == "paused")


def test_one_step(page: Page):
    page.press("Step")
    page.until(lambda: page.text("step") == "31")


def test_speed_is_that_of_the_plant_times_what_the_slider_says(page: Page):
    dashboard, view = page.dashboard, page.dashboard.view
    time_step_s = dashboard.stage.setup.time_step_s

    def place() -> float:
        return view.step + view.cursor / dashboard.stage.rounds

    for speed in (2.0, 0.25):
        page.enter("Speed", speed)
        page.until(lambda speed=speed: view.speed == speed)
        dashboard.inputs.alter(lambda view: view.look_at(5))
        page.press("Resume")
        page.until(lambda: view.playing)
        before = place()
        page.draw()
        # A turn of the loop is at most half a second, however long it took.
        assert place() - before == pytest.approx(0.5 * speed / time_step_s)
        page.press("Pause")
        page.until(lambda: not view.playing)
    page.enter("Speed", 1)
    page.until(lambda: view.speed == 1)


def test_the_slider_goes_to_a_step_and_everything_follows(page: Page):
    page.enter("Step", 12)
    page.until(lambda: page.text("step") == "12")
    cycle = page.dashboard.history.at(12).cycles[-1].bus_cycle
    page.until(lambda: int(page.text("bus-cycle")) in range(cycle - 2, cycle + 1))
    page.press("Go to the end")
    page.until(lambda: page.text("step") == "39")


def test_what_is_entered_holds_though_a_picture_of_before_is_drawn_meanwhile(page: Page):
    free = Event()
    # viser's threads are all at work when the value comes, and the loop draws step 30 once more.
    pool = page.dashboard.server.gui._thread_executor
    busy = [pool.submit(free.wait, 30) for _ in range(pool._max_workers)]
    entered = Event()

    async def note(_) -> None:
        entered.set()

    page.dashboard.page.slider.on_update(note)
    page.enter("Step", 17)
    assert entered.wait(10)
    page.dashboard.inputs.point(3)
    page.draw()
    free.set()
    assert all(job.result() for job in busy)
    page.until(lambda: page.text("step") == "17", seconds=5)


def test_a_row_of_the_table_selects(page: Page):
    press_on(page.page, row_of(5))
    page.until(lambda: is_selected(page, 5))
    page.page.get_by_text("Selected", exact=True).first.click()
    page.until(lambda: "node 05" in page.text("selected"))
    page.page.get_by_text("Nodes", exact=True).first.click()


def test_a_frame_on_the_bus_selects(page: Page):
    for node in nodes_on_the_bus(page):
        press_on(page.page, slot_of(node))
        page.until(lambda node=node: is_selected(page, node))


def test_a_belief_selects(page: Page):
    # Beliefs lie upon each other; one whose middle is on top of the others.
    find = """belief => {
        const box = belief.getBoundingClientRect();
        const top = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
        return belief.contains(top);
    }"""
    beliefs = page.page.locator('[data-testid="zoom"] [data-node]').all()
    belief = next(belief for belief in reversed(beliefs) if belief.evaluate(find))
    node = int(belief.get_attribute("data-node") or -1)
    belief.click()
    page.until(lambda: is_selected(page, node))


def test_a_press_is_not_lost_among_what_the_pointer_does_around_it(page: Page):
    nodes = nodes_on_the_bus(page)[:3]
    assert len(set(nodes)) == 3
    page.page.evaluate(_PRESS_AND_MOVE_ON, nodes)
    page.until(lambda: page.dashboard.view.selected == nodes[1], seconds=5)
    page.until(lambda: page.dashboard.view.hovered == nodes[2], seconds=5)


def test_the_same_node_can_be_pressed_again(page: Page):
    node = nodes_on_the_bus(page)[0]
    for _ in range(2):
        press_on(page.page, slot_of(node))
        page.until(lambda: page.dashboard.view.selected == node)
        page.dashboard.inputs.select(None)
        page.until(lambda: page.dashboard.view.selected is None)
        # The state that a press left behind selects no node when the pointer moves on.
        page.page.mouse.move(400, 20)
        page.until(lambda: page.dashboard.view.hovered is None)
        assert page.dashboard.view.selected is None


def test_the_pointer_on_a_frame_or_a_row_shows_its_node_and_leaves_no_trace(page: Page):
    node = nodes_on_the_bus(page)[0]
    for place in (slot_of(node), row_of(node)):
        point_at(page.page, place)
        page.until(lambda: page.part("/network/hovered")["shown"] and is_marked(page, node))
        assert page.dashboard.view.selected is None
        page.page.mouse.move(400, 20)
        page.until(lambda: not page.part("/network/hovered")["shown"])
        page.until(lambda: not is_marked(page, node))
    # Faster than any picture.
    page.dashboard.inputs.point(node)
    page.dashboard.inputs.point(None)
    page.draw()
    assert page.dashboard.view.hovered is None


def test_what_anybody_writes_into_the_bridge_is_a_node_or_nothing(page: Page):
    write = """text => {
        const label = [...document.querySelectorAll('label')]
            .find(label => label.textContent === 'bridge');
        const input = label.closest('.mantine-Flex-root').querySelector('input');
        Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(input, text);
        input.dispatchEvent(new Event('input', {bubbles: true}));
    }"""
    for text in ("8 8@1", "-1 -1@2", "x <b>@3", "1" * 6000, "3 99@4"):
        page.page.evaluate(write, text)
        page.page.wait_for_timeout(80)
        page.draw()
        assert page.dashboard.view.selected is None
    page.until(lambda: page.dashboard.view.hovered == 3)
    page.page.evaluate(write, "3 4@5")
    page.until(lambda: page.dashboard.view.selected == 4)


def test_a_click_on_a_node_in_the_scene_selects(page: Page):
    frame = page.dashboard.history.at(30)
    places = page.dashboard.page.scene.plant.node_places(frame, [frame])
    seen = page.pixels(places)
    # The node must be one that no panel covers.
    node = min(range(len(seen)), key=lambda i: abs(seen[i][0] - 450) + abs(seen[i][1] - 260))
    page.page.mouse.click(*seen[node])
    page.until(lambda: is_selected(page, node))


def test_choices(page: Page):
    page.choose("Ellipses", "none")
    page.until(lambda: page.dashboard.view.ellipses == "none")
    page.choose("Ellipses", "all")
    page.until(lambda: page.dashboard.view.ellipses == "all")
    page.choose("Table by", "error")
    errors = -page.dashboard.history.at(30).scores.error
    wanted = [str(node) for node in np.argsort(errors, kind="stable")]
    rows = page.page.locator('[data-testid="nodes"] tr[data-node]')
    page.until(lambda: [row.get_attribute("data-node") for row in rows.all()] == wanted)
    page.choose("Table by", "number")
    page.until(lambda: page.dashboard.view.order == "number")


@pytest.mark.usefixtures("_slowly")
def test_keys(page: Page):
    page.key("n")
    page.until(lambda: page.text("step") == "31")
    page.key("p")
    page.until(lambda: page.text("mode") == "playing")
    page.key("p")
    page.until(lambda: page.text("mode") == "paused")
    page.key("g")
    page.until(lambda: page.text("step") == "39")
    page.key("j")
    page.until(lambda: is_selected(page, 0))
    page.key("j")
    page.until(lambda: is_selected(page, 1))
    page.key("k")
    page.key("k")
    page.until(lambda: is_selected(page, 7))
    page.key("x")
    page.until(lambda: not page.part("/network/selected")["shown"])


def test_dark_and_light(page: Page):
    def ink() -> str:
        return page.page.get_by_test_id("nodes").evaluate("e => getComputedStyle(e).color")

    dark = ink()
    page.key("d")
    page.until(lambda: ink() != dark and not page.dashboard.view.theme.dark)
    light = page.dashboard.view.theme.text
    assert ink() == f"rgb({', '.join(map(str, light))})"
    page.widget("Dark").locator("input").first.click()
    page.until(lambda: ink() == dark)


def test_exports(page: Page):
    scene = page.download("Run (.html)").decode()
    assert scene.lstrip().lower().startswith("<!doctype html")
    assert len(scene) > 200_000
    charts = page.download("Charts (.html)").decode()
    assert charts.count("<svg") == 5
    assert "<script" not in charts
    assert colours_of(page.download("Charts (.png)")) > 20
    archive = zipfile.ZipFile(io.BytesIO(page.download("Run folder (.zip)")))
    assert {Path(name).name for name in archive.namelist()} == {"run.mcap", "run.json"}
    picture = imread(io.BytesIO(page.download("Scene (.png)")), format="png")
    # The ground is opaque, and the title and the legend are written on it.
    assert (picture.shape[-1] == 3) or (picture[..., 3] == 1).all()
    assert picture.shape[1] >= 1600
    ground = picture[-3, -3, :3]
    for strip in (picture[10:32], picture[-90:]):
        assert (np.abs(strip[..., :3] - ground).max(-1) > 0.4).sum() > 500
    # The scene between them is not uniform.
    assert len(np.unique(picture[40:-90, :, :3].reshape(-1, 3), axis=0)) > 100


def colours_of(picture: bytes) -> int:
    """How many colours a PNG has: a blank one has one."""
    pixels = imread(io.BytesIO(picture), format="png")[..., :3]
    return len(np.unique(pixels.reshape(-1, 3), axis=0))


def test_the_console_is_clean(page: Page):
    assert page.console == []
