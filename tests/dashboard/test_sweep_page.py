"""The page of a sweep: its cells, its limits, and runs that are those of the sweep."""

import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from concord.dashboard.frames.source import assembled
from concord.dashboard.frames.stage import set_stage
from concord.dashboard.sweeps.details import MOST_ROWS, cell_table, runs_panel
from concord.dashboard.sweeps.scatter import axes_of, scatter
from concord.dashboard.sweeps.sweep_page import SweepPage
from concord.dashboard.sweeps.swept import CellQuantity, Choices, SweptCells, looks, shown_cells
from concord.dashboard.theme import DARK
from concord.experiments.explored_sweep import UP, RunPages, swept_of
from concord.experiments.page_options import PageOptions
from concord.results.folder import read_description
from concord.results.records.netcdf_file import RECORDING
from concord.runtime.recording import read_recording
from concord.studies.sweep.results import read_result
from tests.dashboard.browser_page import press_on
from tests.dashboard.browser_tab import new_tab
from tests.processes import CONCORD

TABLE = '[data-testid="cell-table"]'
SWEEP = shlex.split(
    "sweep --scenario oscillator --nodes 4 --steps 25 --graph ring,path --rule ci,wac "
    "--occupancy 0.5,1 --schedule hybrid --runs 6 --workers 1"
)


class Result(NamedTuple):
    """The result of a sweep, as its page shows it, and its runs."""

    path: Path
    swept: SweptCells
    pages: RunPages


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Result]:
    path = tmp_path_factory.mktemp("sweep") / "sweep.nc"
    subprocess.run([*CONCORD, *SWEEP, "-o", str(path)], check=True, capture_output=True)
    dataset = read_result(path)
    pages = RunPages(dataset, path, PageOptions(http_port=0))
    yield Result(path, swept_of(dataset, path.name), pages)
    pages.close()


def made_up(values: np.ndarray, **fields: list[Any]) -> SweptCells:
    """Return a sweep of a figure (C,) without single runs."""
    cells = len(values)
    figure = CellQuantity("figure", np.stack([values, 0.9 * values, 1.1 * values], axis=1), 1.0)
    return SweptCells(
        "made up", "m", fields, (figure,), "", np.arange(3), np.full((cells, 3), np.nan),
        np.arange(5.0), {"nodes": np.ones((cells, 5))},
    )  # fmt: skip


def choices_of(swept: SweptCells, **chosen: Any) -> Choices:
    """Return the first choices of a page, or others."""
    axes = axes_of(swept)
    return Choices(DARK, **{"across": axes[-1], "up": axes[0], "colour": swept.colour, **chosen})


def test_a_run_is_that_of_the_sweep(result: Result):
    cell, place = 5, 2
    steps: list[int] = []
    url = result.pages.open(cell, place, steps.append)
    assert steps[-1] == 25 - 1 or steps[-1] == 25
    folder = result.path.with_name("sweep.nc.runs") / f"cell-{cell}-run-{place}"
    setup = read_description(folder).setup
    assert setup.scenario.run == place
    frames = list(assembled(set_stage(setup), read_recording(folder / RECORDING)))
    first = frames[0].stage.score.first_step
    scored = [frame.scores.rmse for frame in frames if frame.step >= first]
    assert np.sqrt(np.mean(np.square(scored))) == pytest.approx(result.swept.rmse[cell, place])
    # The second time, it is there.
    steps.clear()
    assert result.pages.open(cell, place, steps.append) == url
    assert steps == []


def test_a_folder_of_another_run_is_refused(result: Result):
    one = result.path.with_name("sweep.nc.runs")
    result.pages.open(0, 0, lambda _: None)
    shutil.copytree(one / "cell-0-run-0", one / "cell-7-run-1")
    with pytest.raises(ValueError, match="cell-7-run-1: holds a run of another sweep; move or"):
        result.pages.open(7, 1, lambda _: None)


def test_the_figures_are_those_of_the_table(result: Result):
    swept = result.swept
    assert set(swept.fields) == {"graph", "rule", "occupancy"}
    assert swept.rmse.shape == (8, 6)
    figure = next(one for one in swept.quantities if one.name == "RMSE [m]")
    assert figure.intervals[:, 0] == pytest.approx(np.sqrt(np.square(swept.rmse).mean(axis=1)))
    for cell, rmse in enumerate(swept.rmse):
        middle = rmse[swept.middle_run(cell)]
        assert abs(middle - np.median(rmse)) == np.abs(rmse - np.median(rmse)).min()


def test_limits_leave_their_cells_and_the_least_value_comes_first(result: Result):
    swept = result.swept
    choices = choices_of(swept, up=UP, limits={"rule": ("ci",), "occupancy": (1.0,)})
    shown = shown_cells(swept, choices)
    assert [swept.words(cell) for cell in np.flatnonzero(shown).tolist()] == [
        "graph=ring, rule=ci, occupancy=1", "graph=path, rule=ci, occupancy=1",
    ]  # fmt: skip
    assert cell_table(swept, choices).count("<tr data-node") == 2
    assert scatter(swept, choices).count("<g data-node") == 2
    up = next(one for one in swept.quantities if one.name == UP)
    html = cell_table(swept, choices_of(swept, up=UP))
    rows = [int(part.split('"')[0]) for part in html.split('<tr data-node="')[1:]]
    assert rows == np.argsort(up.intervals[:, 0], kind="stable").tolist()


def test_each_value_has_a_sign_and_a_colour_of_its_own(result: Result):
    look = looks(result.swept, choices_of(result.swept, colour="rule"))
    by_rule = dict(zip(result.swept.fields["rule"], look, strict=True))
    assert len(set(look)) == 2
    assert by_rule["ci"][0] != by_rule["wac"][0] and by_rule["ci"][1] != by_rule["wac"][1]


@pytest.mark.parametrize(
    ("values", "numbers"),
    [
        (np.array([0.01, 0.5, 400.0]), {"0.01", "1", "100"}),
        (np.array([2.0, 3.0, 5.0]), {"2", "4"}),
        (np.array([1.0, 1.0, 1.0]), {"1"}),
        (np.array([np.nan, 0.0, 2.0]), {"0", "1", "2"}),
    ],
)
def test_an_axis_holds_its_cells_and_is_logarithmic_where_they_are_far_apart(values, numbers):
    swept = made_up(values, rule=["a", "b", "c"])
    html = scatter(swept, choices_of(swept))
    texts = {part.split("<")[0].split(">")[-1] for part in html.split("</text>")}
    written = {part.rsplit(">", 1)[-1] for part in html.split("</text>")}
    assert numbers <= texts | written
    known = int(np.isfinite(values).sum())
    assert html.count("<g data-node") == known
    heights = [float(part.split('"')[0]) for part in html.split('r="13"')[0].split('cy="')[1:]]
    assert all(20 <= height <= 520 for height in heights)


def test_text_of_a_user_is_escaped_and_long_tables_say_what_they_leave_out():
    cells = MOST_ROWS + 7
    swept = made_up(
        np.linspace(1, 2, cells), rule=["<img src=x>"] * cells, nodes=list(range(cells))
    )
    choices = choices_of(swept, selected=1, across="nodes")
    html = cell_table(swept, choices) + scatter(swept, choices) + runs_panel(swept, choices)
    assert "<img" not in html
    assert "7 more cells have larger values" in html
    assert "kept no single runs" in html


@pytest.mark.slow
def test_moments_have_a_page_too(tmp_path: Path):
    path = tmp_path / "moments.nc"
    words = [*SWEEP, "--keep", "moments", "-o", str(path)]
    subprocess.run([*CONCORD, *words], check=True, capture_output=True)
    swept = swept_of(read_result(path), path.name)
    assert np.isnan(swept.rmse).all() and swept.middle_run(3) == 0
    assert np.isfinite(swept.errors["nodes"][:, 5:]).all()
    assert "kept no single runs" in runs_panel(swept, choices_of(swept, selected=2))


def test_cells_are_pressed_and_their_runs_open(chromium, result: Result):
    shown = SweepPage(result.swept, result.pages.open, "127.0.0.1", 0, DARK, UP)
    page = new_tab(chromium, 1366, 768)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    try:
        page.goto(f"{shown.url}&fixedDpr=0.5")
        row = f'{TABLE} tr[data-node="3"]'
        # A press in the table marks the cell in the picture, and shows its runs.
        presses(page, shown, row, lambda: shown.choices.selected == 3)
        waits(page, shown, lambda: page.locator('[data-testid="runs"] circle').count() == 6)
        waits(page, shown, lambda: page.get_by_test_id("errors").count() == 1)
        rings = page.locator('[data-testid="cells"] [data-node="3"] circle')
        waits(page, shown, lambda: rings.count() == 2)
        # So does a press in the picture.
        sign = '[data-testid="cells"] [data-node="6"] text'
        presses(page, shown, sign, lambda: shown.choices.selected not in (None, 3))
        chosen = shown.choices.selected
        # A press on a run opens its page in this browser.
        run = '[data-testid="runs"] circle[data-node="4"]'
        presses(page, shown, run, lambda: page.get_by_test_id("timeline").count() == 1)
        folder = result.path.with_name("sweep.nc.runs") / f"cell-{chosen}-run-4"
        assert (folder / RECORDING).is_file()
        assert errors == []
    finally:
        page.close()
        shown.close()


def test_keys_choose_cells_and_the_picture_fills_its_panel(chromium, result: Result):
    shown = SweepPage(result.swept, result.pages.open, "127.0.0.1", 0, DARK, UP)
    page = new_tab(chromium, 1280, 720)
    try:
        page.goto(f"{shown.url}&fixedDpr=0.5")
        waits(page, shown, lambda: page.title() == result.swept.title)
        cells = page.locator('[data-testid="cells"]')
        waits(page, shown, lambda: cells.count() == 1 and cells.bounding_box()["height"] > 550)
        page.keyboard.press("d")
        waits(page, shown, lambda: not shown.choices.theme.dark)
        box = page.locator('.concord-marks[aria-label^="table of cells"]')
        waits(page, shown, lambda: box.count() == 1)
        box.focus()
        rows = [
            int(str(row.get_attribute("data-node")))
            for row in page.locator(f"{TABLE} tr[data-node]").all()
        ]
        # A row and its button are two stops.
        for key in ("ArrowDown", "ArrowDown", "ArrowDown", "Enter"):
            page.keyboard.press(key)
        waits(page, shown, lambda: shown.choices.selected == rows[1])
    finally:
        page.close()
        shown.close()


def test_a_phone_shows_the_picture_without_a_press(chromium, result: Result):
    shown = SweepPage(result.swept, result.pages.open, "127.0.0.1", 0, DARK, UP)
    page = new_tab(chromium, 390, 844)
    try:
        page.goto(f"{shown.url}&fixedDpr=0.5")
        cells = page.locator('[data-testid="cells"]')

        def is_whole() -> bool:
            box = cells.bounding_box() if cells.count() else None
            return box is not None and box["y"] + box["height"] < 844

        waits(page, shown, is_whole)
        assert shown.choices.width == 390
    finally:
        page.close()
        shown.close()


def presses(page: Any, shown: SweepPage, selector: str, holds: Callable[[], bool]) -> None:
    """Press an element until something holds: panels move while a page arranges itself."""
    for _ in range(20):
        shown.draw()
        if page.locator(selector).count():
            press_on(page, selector)
        with suppress(AssertionError):
            waits(page, shown, holds, polls=80)
            return
    raise AssertionError(f"{selector}: no press had an effect")


def waits(page: Any, shown: SweepPage, holds: Callable[[], bool], polls: int = 1500) -> None:
    """Draw until something holds in a browser."""
    for _ in range(polls):
        shown.draw()
        if holds():
            return
        page.wait_for_timeout(60)
    raise AssertionError("it never came to hold")
