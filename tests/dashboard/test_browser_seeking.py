"""Ways to a step in a real browser: one cursor in all charts, loops, and conditions."""

from collections.abc import Iterator

import pytest

from tests.dashboard.browser_page import Page, point_at, press_on, recorded_page

_CURSORS = """() => Object.values(window.__viserTestpoints.uplots).map(({chart}) => ({
    time: chart.cursor.idx === null ? null : chart.data[0][chart.cursor.idx],
    values: chart.cursor.idx === null ? [] : chart.data.slice(1).map(y => y[chart.cursor.idx]),
    told: [...chart.root.querySelectorAll('.u-value')]
        .filter(e => e.offsetWidth).map(e => parseFloat(e.textContent)),
    named: [...chart.root.querySelectorAll('.u-label')].some(e => e.offsetWidth),
}))"""
_PLACE = """([chart, time]) => {
    const plot = Object.values(window.__viserTestpoints.uplots)[chart].chart;
    const box = plot.over.getBoundingClientRect();
    return [box.x + plot.valToPos(time, 'x'), box.y + box.height / 2];
}"""


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    shown = recorded_page(
        chromium, tmp_path_factory.mktemp("seek"), nodes=8, steps=90, changes=("40 kill 3",)
    )
    # All charts that a pointer goes to have room.
    shown.page.set_viewport_size({"width": 1600, "height": 1000})
    yield shown
    shown.close()


@pytest.fixture(autouse=True)
def _begin(page: Page) -> None:
    page.page.mouse.move(400, 20)
    page.dashboard.inputs.alter(lambda view: setattr(view, "loop", None))
    go_to(page, 89)
    page.until(lambda: len(cursors(page)) == 5)


def go_to(page: Page, step: int) -> None:
    page.dashboard.inputs.alter(lambda view: view.look_at(step))
    page.until(lambda: page.text("step") == str(step))


def cursors(page: Page) -> list[dict]:
    return page.page.evaluate(_CURSORS)


def place(page: Page, chart: int, time_s: float) -> list[float]:
    return page.page.evaluate(_PLACE, [chart, time_s])


def reads(page: Page, chart: int, time_s: float) -> bool:
    """Move the pointer to where a time is in a chart now, and say whether all charts mark it."""
    page.page.mouse.move(*place(page, chart, time_s))
    return [one["time"] for one in cursors(page)] == [time_s] * 5


@pytest.mark.parametrize("chart", [0, 2])
def test_a_pointer_on_one_chart_reads_the_values_of_its_step_in_all(page: Page, chart: int):
    page.until(lambda: all(one["named"] for one in cursors(page)[:1]))
    page.until(lambda: reads(page, chart, 57))
    scores = page.dashboard.history.at(57).scores
    first, spread, nees = cursors(page)[:3]
    assert first["told"] == pytest.approx([57, scores.rmse, scores.fused, scores.central], abs=1e-3)
    # The value of a single line stands beside the title, without the time.
    assert (spread["told"], nees["told"]) == (
        pytest.approx([scores.spread], abs=1e-3), pytest.approx([scores.nees], abs=1e-3),
    )  # fmt: skip
    assert not any(one["named"] for one in cursors(page))
    pointer = page.page.get_by_test_id("run-pointer")
    assert pointer.get_attribute("visibility") == "visible"
    page.page.mouse.move(400, 20)
    page.until(
        lambda: page.page.get_by_test_id("run-pointer").get_attribute("visibility") == "hidden"
    )
    page.until(lambda: cursors(page)[0]["named"])


def test_a_pointer_on_the_strip_marks_its_step_in_all_charts(page: Page):
    # A step before the first of the charts is in none.
    for step, expected in ((33, 33), (3, None), (70, 70)):

        def marks(step: int = step, expected: int | None = expected) -> bool:
            point_at(page.page, f'[data-testid="run"] .bin[data-node="{step}"]')
            return [one["time"] for one in cursors(page)] == [expected] * 5

        page.until(marks)


def test_a_press_in_a_chart_shows_its_step_and_a_drag_does_not(page: Page):
    began, ended = place(page, 1, 50), place(page, 1, 70)
    page.page.mouse.move(*began)
    page.page.mouse.down()
    page.page.mouse.move(*ended, steps=4)
    page.page.mouse.up()
    for _ in range(3):
        page.draw()
        page.page.wait_for_timeout(60)
    assert page.text("step") == "89"
    # In the enlarged part a press shows the step under it, too.
    page.page.mouse.click(*place(page, 1, 61))
    page.until(lambda: page.text("step") == "61")
    page.page.reload()
    page.until(lambda: page.page.get_by_test_id("nodes").count() == 1 and len(cursors(page)) == 5)
    go_to(page, 89)
    page.until(lambda: len(cursors(page)) == 5)
    page.page.mouse.click(*place(page, 0, 44))
    page.until(lambda: page.text("step") == "44")


def test_a_loop_between_two_steps_is_drawn_and_played(page: Page):
    go_to(page, 30)
    page.press("from")
    page.until(lambda: page.dashboard.view.loop == (30, 89))
    go_to(page, 33)
    page.key("o")
    page.until(lambda: page.dashboard.view.loop == (30, 33))
    page.until(lambda: page.page.get_by_test_id("loop").count() == 1)
    page.press("Resume")
    seen: list[int] = []

    def has_gone_round() -> bool:
        seen.append(page.dashboard.view.step)
        return seen[-1] == 30 and seen.count(33) > 0 and {*seen} >= {30, 31, 32, 33}

    page.until(has_gone_round)
    assert {*seen} == {30, 31, 32, 33}
    page.press("Pause")
    page.press("off")
    page.until(lambda: page.page.get_by_test_id("loop").count() == 0)


def test_a_recording_is_sought_for_the_next_step_at_which_a_condition_holds(page: Page):
    scores = [page.dashboard.history.at(step).scores for step in range(90)]
    limit = sorted(one.rmse for one in scores[20:])[-5]
    holds = [step for step in range(20, 90) if scores[step].rmse > limit]
    go_to(page, 20)
    page.widget("Until").locator("input").fill(f"rmse > {limit}")
    for step in [one for one in holds if one > 20]:
        page.press("Run until")
        page.until(lambda step=step: page.text("step") == str(step))
    page.press("Run until")
    page.until(lambda: page.page.get_by_text("holds in no step up to 89").count() > 0)
    go_to(page, 5)
    page.widget("Until").locator("input").fill("down 3")
    page.press("Run until")
    page.until(lambda: page.text("step") == "40")
    page.widget("Until").locator("input").fill("nes > 3")
    page.press("Run until")
    page.until(lambda: page.page.get_by_text("did you mean 'nees'").count() > 0)
    assert page.text("step") == "40"


def test_the_console_is_clean(page: Page):
    press_on(page.page, '[data-testid="run"] .bin[data-node="20"]')
    assert page.console == []
