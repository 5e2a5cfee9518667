"""The first screen, themes at rest, presenting, and a page whose program is gone."""

from collections.abc import Callable, Iterator

import pytest

from concord.dashboard.serve import open_recording
from tests.dashboard.browser_page import Page, recorded
from tests.dashboard.contrast import pairs_of

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

# Of the bus: pixels between the numbers of the cycles and the first slot, and the left edge.
_SPACE_BESIDE_NUMBERS = (
    "()=>{const box=e=>e.getBoundingClientRect(),"
    "bus=document.querySelector('[data-testid=timeline]'),"
    "slots=Math.min(...[...bus.querySelectorAll('rect')].map(e=>box(e).left)),"
    "numbers=[...bus.querySelectorAll('.number')].map(box);"
    "return Math.min(...numbers.map(e=>Math.min(slots-e.right,e.left-box(bus).left)))}"
)
_WIDTH_OF_BUS = "()=>document.querySelector('[data-testid=timeline]').getBoundingClientRect().width"
_FOCUSED = "()=>document.activeElement.querySelector('[data-testid]')?.dataset.testid"
# The name of the element that has the focus: that of its picture, or its own.
_STOP = (
    "()=>{const e=document.activeElement,marks=e.classList.contains('concord-marks')&&"
    "e.querySelector('[data-testid]').dataset.testid;return marks||e.ariaLabel||"
    "e.textContent.trim()||e.closest('.mantine-Flex-root,label')?.textContent.trim()||"
    "e.tagName}"
)

# The part of the column with the last chart ends below it, or the table fills its own part.
_IS_SPLIT_BY_NEED = (
    "()=>{const part=q=>{let e=[...document.querySelectorAll(q)].at(-1),last=e;"
    "while(!e.parentElement.hasAttribute('data-dock-scroll'))e=e.parentElement;"
    "return e.getBoundingClientRect().bottom-last.getBoundingClientRect().bottom};"
    "return part('.uplot-container')>=0||Math.abs(part('table.nodes')-20)<21}"
)


# Note the range of time that each plot has when viser registers it.
_NOTE_RANGES = (
    "()=>{window.__ranges=[];const told=window.__viserTestpoints;"
    "told.uplots=new Proxy(told.uplots,{set:(plots,id,plot)=>{plots[id]=plot;"
    "window.__ranges.push([plot.chart.scales.x.min,plot.chart.scales.x.max]);return true}})}"
)
# The range of time of each plot, and that of its data.
_RANGES = (
    "()=>Object.values(window.__viserTestpoints.uplots).map(({chart})=>"
    "[chart.scales.x.min,chart.scales.x.max,chart.data[0][0],chart.data[0].at(-1)])"
)
_HAS_ONE = "ids=>ids.some(id=>id in window.__viserTestpoints.uplots)"


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


def test_charts_at_rest_keep_their_lines_when_theme_size_and_presenting_change_at_once(page: Page):
    page.dashboard.inputs.alter(lambda view: view.look_at(33))
    page.until(lambda: page.text("step") == "33" and len(page.chart_points()) >= 5)
    page.page.evaluate(_NOTE_RANGES)
    for width, height in ((1920, 1080), (800, 600), (1920, 1080), (1280, 720)):
        charts = page.page.evaluate("()=>Object.keys(window.__viserTestpoints.uplots)")
        page.page.set_viewport_size({"width": width, "height": height})
        page.key("f")
        page.key("d")
        page.until(lambda charts=charts: not page.page.evaluate(_HAS_ONE, charts))
        page.until(lambda: len(page.chart_points()) >= 5)
        # A plot takes its last range and width after it is there.
        page.page.wait_for_timeout(500)
        ranges = page.page.evaluate(_RANGES)
        assert all(plot[:2] == pytest.approx(plot[2:]) for plot in ranges), ranges
    noted = page.page.evaluate("()=>window.__ranges")
    assert len(noted) >= 20
    assert all(None not in range_ for range_ in noted)


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


def test_rows_and_slots_are_chosen_by_the_keyboard_while_they_are_drawn_anew(page: Page):
    page.dashboard.inputs.alter(lambda view: view.look_at(20))
    for name in ("nodes", "timeline"):
        marks = page.page.locator(f'[data-testid="{name}"] [data-node]')
        page.until(lambda marks=marks: marks.count() > 2)
        nodes = [int(marks.nth(place).get_attribute("data-node") or -1) for place in range(2)]
        focus(page, name)
        for step, node in enumerate(nodes):
            # Another picture before each key.
            page.dashboard.inputs.alter(lambda view, step=step: view.look_at(21 + step))
            page.until(lambda step=step: page.text("step") == f"{21 + step}")
            page.page.keyboard.press("ArrowRight")
            page.until(lambda: bool(page.page.locator("#concord-spoken").text_content()))
            page.page.keyboard.press("Enter")
            page.until(lambda node=node: page.dashboard.view.selected == node)
        assert page.page.evaluate(_FOCUSED) == name
    page.key("x")
    page.until(lambda: page.dashboard.view.selected is None)


def test_a_step_is_sought_in_the_strip_by_the_keyboard(page: Page):
    focus(page, "run")
    for key, step in (("End", 39), ("ArrowLeft", 38), ("Home", 0)):
        page.page.keyboard.press(key)
        page.page.keyboard.press("Enter")
        page.until(lambda step=step: page.dashboard.view.step == step)
        page.until(lambda step=step: page.text("step") == str(step))


def test_tab_reaches_controls_table_slots_and_strip(page: Page):
    page.page.evaluate("()=>document.activeElement.blur()")
    stops: list[str] = []
    for _ in range(80):
        page.page.keyboard.press("Tab")
        stops.append(page.page.evaluate(_STOP))
    assert {"nodes", "timeline", "run", "Resume"} <= set(stops)
    # Nothing in between holds the focus.
    assert stops.count(stops[0]) <= 3


def test_numbers_of_cycles_stand_between_the_edge_and_the_slots(page: Page):
    page.dashboard.inputs.alter(lambda view: view.look_at(39))
    page.until(lambda: len(page.text("bus-cycle")) == 5)
    for width, height in ((800, 600), (1920, 1080)):
        before_px = page.page.evaluate(_WIDTH_OF_BUS)
        page.page.set_viewport_size({"width": width, "height": height})
        page.until(lambda before=before_px: page.page.evaluate(_WIDTH_OF_BUS) != before)
        page.until(lambda: page.page.evaluate(_SPACE_BESIDE_NUMBERS) >= 0)


@pytest.mark.parametrize("height", [720, 1080])
def test_no_chart_is_cut_while_the_panel_of_the_table_is_empty(page: Page, height: int):
    page.page.set_viewport_size({"width": 1920, "height": height})
    page.until(lambda: page.page.locator(".uplot-container").count() >= 5)
    page.until(lambda: page.page.evaluate(_IS_SPLIT_BY_NEED))


def focus(page: Page, name: str) -> None:
    """Put the focus on the element around a picture of marks."""
    box = page.page.locator(f'.concord-marks:has([data-testid="{name}"])')
    page.until(lambda: box.count() == 1)
    box.focus()


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_every_text_has_contrast(
    page: Page, theme: str, record_property: Callable[[str, object], None]
):
    page.page.set_viewport_size({"width": 1920, "height": 1080})
    page.dashboard.inputs.alter(lambda view: view.look_at(33))
    if page.dashboard.view.theme.dark != (theme == "dark"):
        page.key("d")
    page.until(lambda: page.dashboard.view.theme.dark == (theme == "dark"))
    page.until(lambda: page.text("step") == "33")
    page.page.wait_for_timeout(1500)
    found = pairs_of(page.page)
    record_property("pairs of colours, least contrast", (len(found), found[0].ratio))
    assert len(found) > 8
    assert not [pair for pair in found if pair.is_faint]


def test_a_page_without_its_program_says_so(page: Page):
    gone = page.page.locator("#concord-gone")
    assert not gone.is_visible()
    page.page.route("**/alive", lambda route: route.abort())
    page.until(gone.is_visible)
    assert "No connection to concord since" in (gone.text_content() or "")
    assert "Start concord again" in (gone.text_content() or "")
    page.page.unroute("**/alive")
