"""The first screen, themes at rest, presenting, and a page whose program is gone."""

from collections.abc import Callable, Iterator

import pytest

from concord.dashboard.serve import open_recording
from tests.dashboard.browser_page import Page, recorded

pytestmark = pytest.mark.browser

_SEEN = """const seen=e=>{const r=e.getBoundingClientRect(),s=getComputedStyle(e);
return r.width>1&&r.height>1&&s.visibility!=='hidden'};"""
_CONTROLS = (
    "()=>{" + _SEEN + "return [...document.querySelectorAll('button,input,select,textarea')]"
    ".filter(seen).length}"
)
# A word has two letters one after the other; notices about the graphics card do not count.
_WORDS = (
    "()=>{" + _SEEN + "const walk=document.createTreeWalker(document.body,NodeFilter.SHOW_TEXT),"
    "all=[];while(walk.nextNode()){const p=walk.currentNode.parentElement;"
    "if(p&&!p.closest('script,style,.mantine-Notification-root')&&seen(p))"
    "all.push(...walk.currentNode.textContent.split(/\\s+/))}"
    "return all.filter(word=>/\\p{L}{2}/u.test(word)).length}"
)
_NAMELESS = (
    "()=>{" + _SEEN + "return [...document.querySelectorAll('button')].filter(seen)"
    ".filter(b=>!b.textContent.trim()&&!b.ariaLabel).length}"
)


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    setup, file = recorded(tmp_path_factory.mktemp("first"), nodes=12, steps=40, seed=3)
    dashboard = open_recording(setup, file, "127.0.0.1", 0, light=False)
    dashboard.view.playing = dashboard.view.follow = False
    shown = Page(dashboard, chromium, open_folders=False)
    yield shown
    shown.close()


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (1920, 1080)])
def test_the_first_screen_has_few_controls_and_few_words(
    page: Page, width: int, height: int, record_property: Callable[[str, object], None]
):
    page.page.set_viewport_size({"width": width, "height": height})
    page.dashboard.inputs.alter(lambda view: view.look_at(33))
    page.until(lambda: page.page.locator(".uplot-container").count() >= 5)
    page.page.wait_for_timeout(1500)
    counts = page.page.evaluate(_CONTROLS), page.page.evaluate(_WORDS)
    record_property(f"controls and words at {width}x{height}", counts)
    assert counts[0] <= 20
    assert counts[1] <= 150
    page.until(lambda: page.page.evaluate(_NAMELESS) == 0)


def test_the_tab_is_called_by_run_and_step_and_the_pill_by_its_recording(page: Page):
    page.dashboard.inputs.alter(lambda view: view.look_at(33))
    assert page.text("run-state").startswith("RECORDED first")
    page.until(lambda: page.page.title().endswith("step 33"))
    assert page.text("mode") == "paused"


def test_all_charts_stay_when_a_page_at_rest_turns_light_and_dark(page: Page):
    page.dashboard.inputs.alter(lambda view: view.look_at(33))
    page.until(lambda: page.text("step") == "33" and len(page.chart_points()) >= 5)
    count = len(page.chart_points())
    for _ in range(3):
        dark = page.dashboard.view.theme.dark
        page.key("d")
        page.until(lambda dark=dark: page.dashboard.view.theme.dark != dark)
        page.until(lambda: len(page.chart_points()) == count)


def test_the_developers_panel_of_viser_is_hidden(page: Page):
    icons = page.page.locator("button:has(.tabler-icon-adjustments)")
    assert not any(icon.is_visible() for icon in icons.all())


def test_presenting_leaves_verdict_bus_and_one_chart_and_ends(page: Page):
    page.page.set_viewport_size({"width": 1280, "height": 720})
    pause = page.page.get_by_role("button", name="Resume", exact=True).first
    charts = page.page.locator(".uplot-container")
    page.until(lambda: pause.is_visible())
    page.key("f")
    page.until(lambda: not pause.is_visible())
    page.until(lambda: sum(chart.is_visible() for chart in charts.all()) == 1)
    assert page.page.get_by_test_id("timeline").first.is_visible()
    assert not page.page.get_by_test_id("nodes").first.is_visible()
    verdict = page.page.get_by_test_id("verdict").first.bounding_box()
    assert verdict is not None
    assert verdict["height"] >= 25
    page.key("f")
    page.until(lambda: pause.is_visible() and page.page.get_by_test_id("nodes").is_visible())


def test_a_row_is_selected_by_the_keyboard(page: Page):
    page.page.locator('[data-testid="nodes"] tr[data-node="4"]').focus()
    page.page.keyboard.press("Enter")
    page.until(lambda: page.dashboard.view.selected == 4)
    page.key("x")
    page.until(lambda: page.dashboard.view.selected is None)


def test_a_page_without_its_program_says_so(page: Page):
    gone = page.page.locator("#concord-gone")
    assert not gone.is_visible()
    page.page.route("**/alive", lambda route: route.abort())
    page.until(gone.is_visible)
    assert "No connection to concord since" in (gone.text_content() or "")
    assert "Start concord again" in (gone.text_content() or "")
    page.page.unroute("**/alive")
