"""Charts in a real browser: their range of time, their scales and their words."""

from collections.abc import Iterator

import pytest

from concord.dashboard.view import View
from tests.dashboard.browser_page import Page, recorded_page

_PLOTS = """() => Object.values(window.__viserTestpoints?.uplots ?? {}).map(({chart}) => ({
    title: chart.root.querySelector('.u-title').textContent,
    shown: [chart.scales.x.min, chart.scales.x.max],
    data: [chart.data[0][0], chart.data[0].at(-1)],
    y: [chart.scales.y.min, chart.scales.y.max],
    logarithmic: chart.scales.y.distr === 3,
    across: chart.axes[0].label,
}))"""
SEEN_TIMES = 4


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    # The lie of a node makes every belief wrong, and the scale of the errors logarithmic.
    shown = recorded_page(
        chromium, tmp_path_factory.mktemp("lie"), nodes=8, steps=90, changes=("40 lie 3 5 4",)
    )
    yield shown
    shown.close()


def plots(page: Page) -> dict[str, dict]:
    return {plot["title"]: plot for plot in page.page.evaluate(_PLOTS)}


def fits(plot: dict) -> bool:
    """Whether a plot shows all of its data, and no time without any."""
    return plot["shown"] == pytest.approx(plot["data"], abs=1e-6)


def go_to(page: Page, step: int) -> None:
    page.dashboard.inputs.alter(lambda view: view.look_at(step))
    page.until(lambda: page.text("step") == str(step))


def test_no_chart_is_drawn_before_it_has_two_steps(page: Page):
    assert page.dashboard.stage.score.first_step == 20
    go_to(page, 0)
    page.dashboard.page.charts.set_theme(page.dashboard.view.theme)
    go_to(page, 12)
    page.until(lambda: all(map(fits, plots(page).values())) and len(plots(page)) == 5)
    # Without a placeholder, no plot shows the second from zero to one.
    assert all(plot["data"] == [0, 12] for plot in plots(page).values())


def test_the_charts_show_all_of_the_time_wherever_the_page_is(page: Page):
    for step in (89, 25, 60, 2, 89, 41):
        go_to(page, step)
        first = 20 if step >= 35 else 0
        page.until(
            lambda step=step, first=first: all(
                fits(plot) and plot["data"] == [first, step] for plot in plots(page).values()
            )
        )


def test_a_fresh_page_shows_all_of_the_time_though_data_and_lines_come_at_once(page: Page):
    go_to(page, 70)
    for _ in range(SEEN_TIMES):
        page.page.reload()
        page.until(lambda: len(plots(page)) == 5)
        # Meanwhile the steps and the lines change.
        for step in (3, 50, 80, 70):
            page.dashboard.inputs.alter(lambda view, step=step: view.look_at(step))
            page.dashboard.page.charts.set_theme(page.dashboard.view.theme)
            page.draw()
        page.until(lambda: all(plot["data"] == [20, 70] for plot in plots(page).values()))
        page.until(lambda: all(map(fits, plots(page).values())), seconds=10)


def test_the_scale_of_errors_is_logarithmic_while_they_diverge(page: Page):
    go_to(page, 38)
    page.until(lambda: not plots(page)["RMSE of the nodes [m]"]["logarithmic"])
    go_to(page, 89)
    page.until(lambda: plots(page)["RMSE of the nodes [m]"]["logarithmic"])
    assert plots(page)["RMSE of the nodes [m]"]["y"][0] > 0


def test_the_scene_of_a_network_that_diverges_can_be_fitted_and_followed(page: Page):
    go_to(page, 89)
    page.until(lambda: page.part("/plant/outside")["shown"])
    assert page.part("/plant/factor")["text"] == "errors × 1"
    client = next(iter(page.dashboard.server.get_clients().values()))
    before = client.camera.position
    if not page.page.get_by_role("button", name="Fit", exact=True).count():
        page.page.get_by_text("View", exact=True).first.click()
    page.press("Fit")
    page.until(lambda: client.camera.position[2] > before[2] + 1)
    page.widget("Follow target").locator("input").first.click()
    page.until(lambda: page.dashboard.view.follow_target)
    target, place = page.dashboard.page.scene.target, client.camera.position
    go_to(page, 60)
    page.until(lambda: bool((client.camera.position != place).any()))
    reached = page.dashboard.page.scene.target
    assert target is not None and reached is not None
    moved = reached - target
    assert client.camera.position - place == pytest.approx(moved, abs=0.05)
    page.widget("Follow target").locator("input").first.click()
    page.until(lambda: not page.dashboard.view.follow_target)


def test_the_axes_name_the_time_the_state_and_the_node(page: Page):
    def choose(view: View) -> None:
        view.selected, view.state = 3, 1

    page.dashboard.inputs.alter(choose)
    page.page.get_by_text("One state", exact=True).first.click()
    page.until(lambda: {"vx, node 03 [m/s]", "error of vx, node 03 [m/s]"} <= set(plots(page)))
    # Small charts below the tall one have no room for the name of the time.
    assert {plot["across"] for plot in plots(page).values()} - {None} == {"time [s]"}
    page.dashboard.inputs.alter(lambda view: setattr(view, "selected", 5))
    page.until(lambda: "vx, node 05 [m/s]" in plots(page))
    page.page.get_by_text("Charts", exact=True).first.click()
    page.until(lambda: "RMSE of the nodes [m]" in plots(page))
