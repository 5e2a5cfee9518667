"""The page explains itself in a real browser: verdict, help, tooltips, and what made a number."""

from collections.abc import Iterator

import pytest

from concord.dashboard.explain.tooltips import CHARTS, HEADINGS
from tests.dashboard.browser_page import Page, press_on, recorded_page, row_of
from tests.dashboard.browser_tab import new_tab


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    folder = tmp_path_factory.mktemp("explained")
    shown = recorded_page(chromium, folder, nodes=8, steps=45, graph="ring", loss=0.2)
    shown.dashboard.inputs.alter(lambda view: view.look_at(40))
    shown.until(lambda: shown.text("step") == "40")
    yield shown
    shown.close()


def open_tab(page: Page, name: str) -> None:
    page.page.get_by_role("tab", name=name, exact=True).click()


def test_the_verdict_is_on_the_page_with_its_reason(page: Page):
    assert page.text("verdict") in ("CONSISTENT", "CAUTIOUS")
    assert "errors are" in page.page.locator('[data-testid="verdict"] ~ div').text_content()


def test_a_press_on_a_number_tells_which_shares_made_it(page: Page):
    open_tab(page, "Nodes")
    error = f"{row_of(5)} td.why"
    assert page.page.locator(error).first.text_content()
    press_on(page.page, error)
    page.until(lambda: page.page.get_by_test_id("explanation").is_visible(), 15)
    page.until(lambda: "node 05" in page.text("selected"))
    frame = page.dashboard.history.at(40)
    rows = page.page.locator('[data-testid="explanation"] tr[data-sender]')
    told = {int(row.get_attribute("data-sender")): row for row in rows.all()}
    assert sorted(told) == page.dashboard.stage.setup.neighbours[5]
    for position, (receiver, sender) in enumerate(page.dashboard.stage.heard):
        if receiver == 5:
            cells = told[int(sender)].locator("td").all_text_contents()
            assert cells[1:3] == [f"{frame.weights[position]:.2f}", f"{frame.ages[position]}"]
            slots = {one.frame_id for one in frame.cycles[-1].frames if one.node == sender}
            assert int(cells[4].split()[0]) in slots
    open_tab(page, "Nodes")


def test_a_press_on_the_rest_of_a_row_leaves_the_table_open(page: Page):
    press_on(page.page, f"{row_of(2)} td:nth-child(3)")
    page.until(lambda: page.dashboard.view.selected == 2)
    assert page.page.get_by_test_id("nodes").is_visible()


@pytest.mark.parametrize(
    ("heading", "meaning"),
    [
        ('[role="tab"]:has-text("Bus")', "frames of the shown cycle"),
        ('[role="tab"]:has-text("Beliefs")', "two states of all nodes"),
        ('.u-title:has-text("NEES")', "normalised estimation error squared"),
        ('[data-testid="nodes"] th:has-text("age")', "cycles since"),
        ('div[title]:has(> [data-testid="rmse"])', "root mean square error"),
    ],
)
def test_headings_have_tooltips(page: Page, heading: str, meaning: str):
    found = page.page.locator(heading).first
    found.hover()
    told = found.evaluate(
        "e => [e, ...e.querySelectorAll('*')].map(one => one.title ?? '').join(' ')"
    )
    assert meaning in told


def test_every_tab_folder_and_chart_has_a_tooltip(page: Page):
    headings = page.page.locator('[role="tab"], .u-title')
    names = headings.all_text_contents()
    assert len(names) >= 12
    for heading in headings.all():
        heading.dispatch_event("pointerover")
        assert heading.get_attribute("title") in {*HEADINGS.values(), *CHARTS.values()}


def test_the_help_has_the_legend_and_every_heading(page: Page):
    open_tab(page, "Help")
    page.until(lambda: page.page.get_by_test_id("help").is_visible())
    for words in ("node that is down", "OVERCONFIDENT", "NIS"):
        assert words in page.text("help")
    open_tab(page, "Nodes")


def test_an_address_with_a_step_opens_that_step(page: Page):
    again = new_tab(page.page.context.browser)
    try:
        again.goto(f"{page.dashboard.url}&fixedDpr=0.5&step=17")
        page.until(lambda: page.dashboard.view.step == 17)
        page.until(lambda: page.text("step") == "17")
    finally:
        again.close()
    page.dashboard.inputs.alter(lambda view: view.look_at(40))


def test_the_console_is_clean(page: Page):
    assert page.console == []
