"""Two recorded runs on one page: refusals, ratios, differences, and what the page shows of them."""

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from concord.dashboard.comparison.compared_charts import compared_charts
from concord.dashboard.comparison.other_run import OtherRun, refuse_unlike, running_mean
from concord.dashboard.comparison.ratio_table import ratio_of, ratio_table
from concord.dashboard.frames.expected import nothing_expected
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.source import replayed
from concord.dashboard.frames.stage import set_stage
from concord.dashboard.panels.chart_table import run_charts
from concord.dashboard.panels.charts import sampled
from concord.dashboard.serve import open_recording, other_run
from concord.dashboard.theme import DARK
from concord.dashboard.view import View
from concord.results.figures.intervals import ratio_t
from concord.scenarios.setup import Setup
from tests.dashboard.browser_page import Page, recorded
from tests.dashboard.runs import setup_of
from tests.processes import CONCORD

LABELS = ("slow", "fast")
Pair = tuple[tuple[Setup, Path], tuple[Setup, Path]]


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """Two recordings of one truth; the second sends more often, and ends earlier."""
    runs = [
        recorded(tmp_path_factory.mktemp("run"), nodes=6, seed=4, rounds=rounds, steps=steps)
        for rounds, steps in ((1, 70), (4, 60))
    ]
    return runs[0], runs[1]


def read(pair: Pair, first: int, second: int) -> tuple[FrameHistory, OtherRun, list[StepFrame]]:
    """Return the shown run, the other one, and the other's frames."""
    (setup, file), (beside, file_beside) = pair[first], pair[second]
    history = FrameHistory(set_stage(setup))
    history.add(replayed(set_stage(setup), file))
    other = other_run(beside, file_beside, setup, LABELS, ratio_t)
    for _ in range(5):
        other.poll()
    return history, other, list(replayed(set_stage(beside), file_beside))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"seed": 5}, "seed: 4 in slow, 5 in fast"),
        ({"nodes": 7}, "nodes: 6 in slow, 7 in fast"),
        ({"run": 2}, "run: 0 in slow, 2 in fast"),
    ],
)
def test_runs_that_are_not_of_one_truth_are_refused(changes: dict[str, int], told: str):
    known: dict[str, int] = {"nodes": 6, "seed": 4, "steps": 30, **changes}
    first = setup_of("target-tracking", nodes=6, seed=4, steps=30)
    with pytest.raises(ValueError, match=f"^{told}; two runs on a page must have one scenario"):
        refuse_unlike(first, setup_of("target-tracking", **known), LABELS)
    with pytest.raises(ValueError, match=r"^scenario: target-tracking in slow, oscillator in"):
        refuse_unlike(first, setup_of("oscillator", seed=4), LABELS)
    refuse_unlike(first, setup_of("target-tracking", nodes=6, seed=4, rule="hcmci"), LABELS)


def test_the_truth_of_two_such_runs_is_one(pair: Pair):
    history, other, _ = read(pair, 0, 1)
    for step in (0, 20, 59):
        beside = other.at(step)
        assert beside is not None
        assert np.array_equal(history.at(step).truth, beside.truth)
    assert other.at(60) is None


def test_ratios_are_those_of_the_scored_steps_of_both(pair: Pair):
    history, other, frames = read(pair, 0, 1)
    first = history.at(0).stage.score.first_step
    html = ratio_table(DARK, other, history, 69)
    both = [(history.at(step).scores.rmse, frames[step].scores.rmse) for step in range(first, 60)]
    mine, theirs = np.sqrt(np.mean(np.square(both), axis=0))
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", html[html.index('data-score="rmse"') :])[:5]
    assert cells[:4] == ["RMSE", f"{mine:.4g}", f"{theirs:.4g}", f"{theirs / mine:.3g}"]
    low, high = map(float, cells[4].split(" to "))
    assert low <= theirs / mine <= high
    # Four rounds send four times what one does, exactly, so nothing is left to chance.
    sent = re.findall(r"<td[^>]*>([^<]*)</td>", html[html.index('data-score="payload"') :])[:4]
    assert float(sent[3]) == pytest.approx(4.0, rel=0.01)
    assert "steps 20 to 59" in html
    assert "no scored step" in ratio_table(DARK, other, history, first - 1)


def test_a_run_beside_itself_has_ratios_of_one_and_no_interval(pair: Pair):
    history, other, _ = read(pair, 1, 1)
    html = ratio_table(DARK, other, history, 59)
    rows = re.findall(r'<tr data-score="(\w+)">(.*?)</tr>', html)
    assert {name for name, _ in rows} >= {"rmse", "spread", "nees", "payload"}
    for name, row in rows:
        cells = re.findall(r"<td[^>]*>([^<]*)</td>", row)
        assert cells[3:] == (["-", "-"] if name == "missed" else ["1", "-"])


def test_exchanged_runs_have_inverse_ratios():
    drawn = np.random.default_rng(1)
    first, second = drawn.gamma(2.0, size=(2, 200))
    for is_root in (True, False):
        there, back = (
            ratio_of(*both, is_root, ratio_t) for both in ((first, second), (second, first))
        )
        assert there == pytest.approx((1 / back[0], 1 / back[2], 1 / back[1]))


def test_the_interval_of_the_mean_so_far_holds_it_in_95_percent_of_cases():
    drawn = np.random.default_rng(2)
    held = 0
    for _ in range(400):
        values = drawn.normal(1.5, 1.0, 150)
        mean, low, high = running_mean(values)
        assert mean[-1] == pytest.approx(values.mean())
        assert np.isnan(low[:19]).all()
        batches = [values[i * 15 : i * 15 + 15].mean() for i in range(10)]
        # Student's factor of nine degrees of freedom, from a table.
        half = 2.262 * np.std(batches, ddof=1) / np.sqrt(10)
        assert high[-1] - mean[-1] == pytest.approx(half, rel=1e-3)
        held += bool(low[-1] <= 1.5 <= high[-1])
    # Of 400 cases 380 are expected; the standard deviation is 4.4.
    assert 362 <= held <= 396


def test_each_chart_has_a_line_of_the_other_run_and_the_errors_a_difference(pair: Pair):
    history, other, frames = read(pair, 0, 1)
    stage = history.at(0).stage
    charts = compared_charts(run_charts(stage), other, history)
    sample = sampled(stage, View(step=69), history, nothing_expected)
    steps = [frame.step for frame in sample.frames]
    lines = {
        (chart.name, line.name): line.column(sample) for chart in charts for line in chart.lines
    }
    beside = [frames[step].scores.rmse if step < 60 else np.nan for step in steps]
    mine = np.array([history.at(step).scores.rmse for step in steps])
    assert lines["RMSE of the nodes", "fast"] == pytest.approx(beside, nan_ok=True)
    assert lines["RMSE of the nodes", "nodes, slow"] == pytest.approx(mine)
    difference = lines["RMSE, fast less slow", "of the step"]
    assert difference == pytest.approx(np.array(beside) - mine, nan_ok=True)
    mean = lines["RMSE, fast less slow", "mean so far"]
    assert mean[steps.index(59)] == pytest.approx(np.nanmean(difference))
    for chart in charts:
        solid = [line.colour(DARK) for line in chart.lines if not line.dashed]
        assert len(set(solid)) == len(solid)


@pytest.mark.slow
def test_the_command_refuses_runs_of_other_seeds_in_one_sentence(tmp_path: Path):
    for seed in (1, 2):
        run = [*CONCORD, "run", "--nodes", "4", "--steps", "5", "--seed", str(seed)]
        subprocess.run([*run, "--out", str(tmp_path / str(seed))], check=True, capture_output=True)
    refused = subprocess.run(
        [*CONCORD, "replay", str(tmp_path / "1"), str(tmp_path / "2")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert refused.returncode == 2
    assert "seed: 1 in 1, 2 in 2; two runs on a page must have one scenario" in " ".join(
        refused.stderr.split()
    )


@pytest.fixture(scope="module")
def page(chromium, pair: Pair) -> Iterator[Page]:
    (setup, file), (beside, file_beside) = pair
    other = other_run(beside, file_beside, setup, LABELS, ratio_t)
    dashboard = open_recording(setup, file, "127.0.0.1", 0, light=False, other=other)
    dashboard.view.playing = dashboard.view.follow = False
    shown = Page(dashboard, chromium)
    yield shown
    shown.close()


def test_the_other_run_is_in_the_scene_in_the_charts_and_in_a_table(page: Page):
    page.dashboard.inputs.alter(lambda view: view.look_at(50))
    page.until(lambda: page.text("step") == "50" and page.part("/ghost/fused")["shown"])
    ghost = page.part("/ghost/beliefs")["points"]
    # A cross of two arms for each of six nodes.
    assert len(ghost) == 6 * 2 * 2 * 3
    page.page.get_by_text("Ratios", exact=True).first.click()
    page.until(lambda: "steps 20 to 50" in page.text("ratios"))
    page.until(lambda: page.page.get_by_text("RMSE, fast less slow [m]", exact=True).count() == 1)
    # The other run has ended.
    page.dashboard.inputs.alter(lambda view: view.look_at(65))
    page.until(lambda: page.text("step") == "65" and not page.part("/ghost/fused")["shown"])
    page.until(lambda: "steps 20 to 59" in page.text("ratios"))
    assert page.console == []
    assert page.dashboard.failures.sentences() == []
