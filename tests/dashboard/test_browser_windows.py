"""Windows of several sizes on one page: each has a layout of its own."""

from collections.abc import Iterator
from typing import Any

import pytest

from tests.dashboard.browser_page import Page, recorded_page
from tests.dashboard.browser_tab import new_tab

SIZES = ((800, 600), (1280, 720), (1366, 768), (1920, 1080))
PHONE = (390, 844)
_BOXES = """() => {
    const box = element => {
        const {left, top, right, bottom} = element.getBoundingClientRect();
        return {left, top, right, bottom};
    };
    const named = name => document.querySelector(`[data-testid="${name}"]`);
    return {
        bus: box(named('timeline')),
        legend: box(named('bus-load')),
        nodes: box(named('nodes').parentElement.parentElement),
        chart: box(document.querySelector('.uplot')),
    };
}"""

_BUS_WIDTH = (
    "()=>document.querySelector('[data-testid=timeline]')?.getBoundingClientRect().width ?? 0"
)

# Sizes of the letters in the drawings of the bus panel, and the places of the names in slots.
_LETTERS = """() => [...document.querySelectorAll('.drawing text')].flatMap(text => {
    const shown = text.getBoundingClientRect();
    if (!shown.width) return [];
    const size = parseFloat(getComputedStyle(text).fontSize) * text.getScreenCTM().a;
    const slot = text.parentNode.querySelector(':scope.slot > rect')?.getBoundingClientRect();
    return [[size, slot ? Math.max(slot.left - shown.left, shown.right - slot.right) : 0]];
})"""


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    shown = recorded_page(chromium, tmp_path_factory.mktemp("windows"), nodes=8, steps=30)
    shown.dashboard.inputs.alter(lambda view: view.look_at(25))
    shown.until(lambda: shown.text("step") == "25")
    yield shown
    shown.close()


def visitor(page: Page, size: tuple[int, int]) -> Any:
    """Another browser on the same page."""
    other = new_tab(page.page.context.browser, *size)
    other.goto(f"{page.dashboard.url}&fixedDpr=0.5")
    return other


def boxes(page: Any) -> dict[str, dict[str, float]] | None:
    """Where the panels are, once all are drawn."""
    ready = page.locator('[data-testid="timeline"],[data-testid="nodes"],.uplot').count() >= 3
    return page.evaluate(_BOXES) if ready else None


def is_laid_out(page: Any, width: int, height: int) -> bool:
    """Whether bus, charts and table lie beside each other in a window, and are wide enough."""
    there = boxes(page)
    if there is None:
        return False
    bus, chart, legend = there["bus"], there["chart"], there["legend"]
    return (
        bus["right"] - bus["left"] >= 0.45 * width
        and bus["right"] <= chart["left"]
        and chart["right"] - chart["left"] >= 240
        and chart["right"] <= width
        and legend["bottom"] <= height
        and bus["top"] >= height / 3
        and there["nodes"]["top"] >= chart["bottom"]
    )


@pytest.mark.parametrize("size", SIZES)
def test_the_panels_fit_the_window_and_letters_of_the_bus_can_be_read_in_their_slots(
    page: Page, size: tuple[int, int]
):
    other = visitor(page, size)
    page.until(lambda: is_laid_out(other, *size))
    letters = other.evaluate(_LETTERS)
    assert len(letters) >= 5
    assert min(size_px for size_px, _ in letters) >= 7.5
    assert max(beyond_px for _, beyond_px in letters) <= 1
    other.close()


def test_the_panels_follow_a_window_that_is_resized(page: Page):
    other = visitor(page, SIZES[1])
    page.until(lambda: is_laid_out(other, *SIZES[1]))
    for size in (SIZES[3], SIZES[0], SIZES[1]):
        other.set_viewport_size({"width": size[0], "height": size[1]})
        page.until(lambda size=size: is_laid_out(other, *size))
    other.close()


def test_a_visitor_leaves_the_layout_and_the_camera_of_the_others_alone(page: Page):
    page.until(lambda: is_laid_out(page.page, *SIZES[1]))
    before = boxes(page.page)
    first = min(page.dashboard.server.get_clients().values(), key=lambda one: one.client_id)
    place = first.camera.position.tolist()
    others = [visitor(page, size) for size in (SIZES[0], PHONE, SIZES[3])]
    page.until(lambda: is_laid_out(others[0], *SIZES[0]) and is_laid_out(others[2], *SIZES[3]))
    assert boxes(page.page) == before
    assert first.camera.position.tolist() == place
    for other in others:
        other.close()


def test_a_phone_has_one_column_of_its_whole_width(page: Page):
    phone = visitor(page, PHONE)
    page.until(lambda: phone.get_by_test_id("run-state").count() == 1)
    status = phone.get_by_test_id("step").locator("../..").bounding_box()
    assert status["width"] >= 0.9 * PHONE[0]
    phone.get_by_text("Bus", exact=True).first.click()
    page.until(lambda: phone.get_by_test_id("timeline").count() == 1)
    # As soon as its section is open.
    page.until(lambda: phone.evaluate(_BUS_WIDTH) >= 0.85 * PHONE[0])
    phone.close()


def test_the_console_is_clean(page: Page):
    assert page.console == []
