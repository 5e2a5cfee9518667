"""Test the texts of charts and their form in exported files."""

import io
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from concord.dashboard.frames.expected import nothing_expected
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.scores import score
from concord.dashboard.panels.chart import Curve, Drawn
from concord.dashboard.panels.chart_export import charts_page, charts_picture
from concord.dashboard.panels.chart_table import run_charts, state_charts
from concord.dashboard.panels.charts import sampled, shown_power, titled
from concord.dashboard.panels.states import states
from concord.dashboard.theme import DARK
from concord.dashboard.view import View
from tests.dashboard.runs import run_of

RUN = run_of("oscillator", nodes=4, steps=60)


def chart(title: str, *columns: np.ndarray) -> Drawn:
    """Return a chart with some orange lines."""
    curves = (
        Curve(f"line {number}", (230, 159, 0), False, column)
        for number, column in enumerate(columns)
    )
    times_s = np.linspace(0.0, 0.1 * (len(columns[0]) - 1), len(columns[0]))
    return Drawn(title, times_s, tuple(curves))


RISING, NOTHING = np.linspace(0, 3, 50), np.full(50, np.nan)
VIEW = View(step=41)


@pytest.mark.parametrize(
    ("largest", "power"),
    [
        (3.2e4, 0),
        (4.5e5, 3),
        (12.0, 0),
        (0.02, 0),
        (0.011, -3),
        (0.0011, -3),
        (4e-5, -6),
        (0.0, 0),
        (3e-19, -12),
    ],
)
def test_what_is_small_is_shown_in_a_power_of_ten_that_leaves_digits(largest: float, power: int):
    shown = shown_power([np.array([0.0, largest]), np.zeros(2)])
    assert shown == power
    assert largest < 1e-14 or 0.02 <= largest * 10.0**-shown < 1e5


def test_titles_name_the_unit_and_the_power():
    assert titled("RMSE", "m", 0) == "RMSE [m]"
    assert titled("RMSE", "rad", -3) == "RMSE [10⁻³ rad]"
    assert titled("NEES", "1", 0) == "NEES"
    assert titled("RMSE", "1", -12) == "RMSE [10⁻¹² ]".replace(" ]", "]")


def test_a_colour_means_one_thing_in_a_chart():
    for each in (*run_charts(RUN.stage), *state_charts()):
        solid = [line.colour(DARK) for line in each.lines if not line.dashed]
        assert len(set(solid)) == len(solid)


def test_every_line_has_a_value_for_every_frame():
    sample = sampled(RUN.stage, VIEW, kept(), nothing_expected)
    for each in (*run_charts(RUN.stage), *state_charts()):
        for line in each.lines:
            assert line.column(sample).shape == sample.times.shape


def test_charts_show_the_numbers_of_the_frames():
    sample = sampled(RUN.stage, replace(VIEW, selected=2, state=1), kept(), nothing_expected)
    lines = {
        (each.name, line.name): line.column(sample)[-1]
        for each in (*run_charts(RUN.stage), *state_charts())
        for line in each.lines
    }
    last = sample.frames[-1]
    assert last.step == 41
    sent = sum(cycle.payload_bytes for cycle in last.cycles)
    off = last.belief.mean[2, 1] - last.truth[1]
    deviation = np.sqrt(last.belief.cov[2, 1, 1])
    expected = {
        ("RMSE of the nodes, x", "nodes"): last.scores.rmse,
        ("Disagreement of the nodes, x", "rms spread"): last.scores.spread,
        ("NEES, mean of the nodes", "NEES"): last.scores.nees,
        ("Payload on the bus", "payload"): sent / RUN.stage.setup.time_step_s / 1000,
        ("State", "truth"): last.truth[1],
        ("State", "+3σ"): last.belief.mean[2, 1] + 3 * deviation,
        ("Error", "error"): off,
        ("Error", "−3σ"): -3 * deviation,
    }
    assert {name: lines[name] for name in expected} == pytest.approx(expected)


@pytest.mark.parametrize(("options", "unit"), [({"rounds": 20}, "kB/s"), ({"rounds": 1}, "B/s")])
def test_a_slow_bus_has_its_payload_in_bytes(options: dict[str, int], unit: str):
    stage = run_of("target-tracking", nodes=4, steps=1, **options).stage
    assert [each.unit for each in run_charts(stage) if each.name.startswith("Payload")] == [unit]


def test_the_page_has_a_drawing_with_text_per_chart_that_shows_anything():
    charts = [chart("Error <of> all", RISING, NOTHING), chart("None", NOTHING)]
    page = charts_page(RUN.stage, charts, VIEW)
    assert page.count("<svg") == 1
    assert "<script" not in page
    assert "up to step 41" in page
    drawing = ElementTree.fromstring(page[page.index("<svg") : page.index("</svg>") + 6])
    said = " ".join(drawing.itertext())
    assert "Error <of> all" in said
    assert "line 0" in said
    assert "line 1" not in said


def test_equal_charts_are_equal_bytes():
    charts = [chart("Error", RISING)]
    assert charts_page(RUN.stage, charts, VIEW) == charts_page(RUN.stage, charts, VIEW)


def test_the_picture_has_all_charts_below_each_other():
    from matplotlib.image import imread

    one, three = (
        imread(io.BytesIO(charts_picture(RUN.stage, [chart("Error", RISING)] * count, VIEW)))
        for count in (1, 3)
    )
    assert one.shape[1] == three.shape[1] >= 1200
    assert three.shape[0] == pytest.approx(3 * one.shape[0], abs=3)
    orange = (np.abs(one[..., :3] - np.array([230, 159, 0]) / 255) < 0.02).all(-1)
    assert orange.sum() > 500


def kept() -> FrameHistory:
    history = FrameHistory(RUN.stage)
    history.add(RUN.frames)
    return history


def lines_of(html: str) -> list[np.ndarray]:
    drawing = ElementTree.fromstring(html[html.index("<svg") : html.index("</svg>") + 6])
    return [
        np.array([point.split(",") for point in line.attrib["points"].split()], float)
        for line in drawing.iter("polyline")
    ]


def test_states_show_truth_and_estimate_of_every_state():
    drawn = lines_of(states(RUN.stage, View(step=59, selected=2), kept()))
    assert len(drawn) == 2 * len(RUN.stage.state_names)
    first = RUN.stage.score.first_step
    for number in range(len(RUN.stage.state_names)):
        truth, mean = drawn[2 * number : 2 * number + 2]
        scored = RUN.frames[first:]
        # Pixels downwards: where the one is higher, its y is less.
        above = [f.belief.mean[2, number] - f.truth[number] for f in scored]
        shown = truth[:, 1] - mean[:, 1]
        assert len(shown) == len(scored)
        assert np.corrcoef(above, shown)[0, 1] > 0.99


def test_states_of_an_unknown_truth_are_estimates_alone():
    unknown = FrameHistory(RUN.stage)
    unknown.add(f._replace(truth=np.full_like(f.truth, np.nan)) for f in RUN.frames)
    html = states(RUN.stage, View(step=59), unknown)
    assert "nan" not in html.lower()
    assert len(lines_of(html)) == len(RUN.stage.state_names)


@pytest.mark.parametrize(("apart", "spread"), [(1e-15, 0.0), (1e-9, 1e-9), (0.5, 0.5)])
def test_what_is_rounding_is_no_disagreement(apart: float, spread: float):
    belief, fused = RUN.frames[30].belief, RUN.frames[30].fused
    # Two nodes on either side of the others, whose scored states are large.
    mean = np.full_like(belief.mean, 17.3)
    mean[:2] += np.array([[apart], [-apart]]) * 17.3
    alive = np.ones(RUN.stage.nodes, dtype=bool)
    scores = score(RUN.stage, mean[2], belief._replace(mean=mean), alive, fused, None)
    states = len(RUN.stage.score.states)
    expected = spread * 17.3 * np.sqrt(2 * states / RUN.stage.nodes)
    assert scores.spread == pytest.approx(expected, rel=1e-5, abs=0.0)
