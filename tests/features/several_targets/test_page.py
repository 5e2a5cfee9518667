"""Several targets: their tracks in the frames, the log, the scene and the charts."""

import re
from functools import cache
from typing import Any

import numpy as np
import pytest

from concord.dashboard.frames.expected import nothing_expected
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.stage import PlantDrawing
from concord.dashboard.panels.chart_table import run_charts
from concord.dashboard.panels.charts import sampled
from concord.dashboard.panels.run_strip import RunStrip
from concord.dashboard.scene.scene import Scene
from concord.dashboard.theme import DARK
from concord.dashboard.view import View
from concord.dashboard.window import PageServer
from concord.features.several_targets.frames import NodeTracks, StepTracks
from concord.features.several_targets.page import track_charts
from concord.features.several_targets.scene import track_colour
from concord.features.several_targets.track_log import scored
from concord.results.records.trace import read_trace
from tests.dashboard.runs import run_of

RUN = run_of("target-swarm", nodes=5, targets=4, steps=24, clutter=1.0)


@cache
def told_tracks() -> list[StepTracks]:
    """The tracks of all steps that have some."""
    return [frame.extra for frame in RUN.frames]


def told(tracks: StepTracks) -> list[NodeTracks]:
    """The tracks of all nodes, each of which told some."""
    found = [one for one in tracks.nodes if one is not None]
    assert len(found) == RUN.stage.nodes
    return found


def test_scores_of_the_page_are_those_of_the_results():
    assert len(told_tracks()) == len(RUN.frames)
    assert any(tracks.gospa_m.max() > 0 for tracks in told_tracks())
    for tracks in told_tracks():
        for node, of_node in enumerate(told(tracks)):
            found = scored(tracks.paths, of_node.report)
            shown = tracks.gospa_m[node], tracks.missed[node], tracks.false[node]
            assert shown == pytest.approx((found.distance, found.missed, found.false))


def test_the_error_of_the_page_is_gospa_as_that_of_the_results_is():
    for frame, tracks in zip(RUN.frames, told_tracks(), strict=True):
        assert frame.scores.rmse == pytest.approx(np.sqrt((tracks.gospa_m**2).mean()))
        assert np.isnan(frame.scores.central)
    titles = [(chart.name, chart.unit) for chart in run_charts(RUN.stage)]
    assert not any(name.startswith("RMSE") for name, _ in titles)
    assert ("GOSPA of the tracks", "m") in titles
    assert ("Disagreement of the nodes", "targets") in [
        (n.split(",")[0], unit) for n, unit in titles
    ]
    history = FrameHistory(RUN.stage)
    history.add(RUN.frames)
    strip = RunStrip().draw(RUN.stage, View(), history)
    assert ">GOSPA<" in strip and "RMSE" not in strip


def test_births_and_deaths_in_the_log_are_those_of_the_tracks():
    before: set[str] = set()
    for frame, tracks in zip(RUN.frames, told_tracks(), strict=True):
        words = [event.text for event in frame.events]
        born, died = (
            {found.group(1) for text in words if (found := re.fullmatch(sentence, text))}
            for sentence in (r"track (\d+) is born", r"track (\d+) has died")
        )
        now = {str(number) for one in told(tracks) for number in one.numbers}
        assert (born, died) == (now - before, before - now)
        before = now
    assert before


def test_targets_that_come_and_leave_are_in_the_log():
    there: set[int] = set()
    for frame, tracks in zip(RUN.frames, told_tracks(), strict=True):
        now = set(np.flatnonzero(np.isfinite(tracks.paths).all(axis=-1)).tolist())
        words = {event.text for event in frame.events if event.text.startswith("target")}
        expected = {f"target {k} is there" for k in now - there}
        assert words == expected | {f"target {k} has left" for k in there - now}
        there = now


def test_a_track_has_one_number_and_colour_at_all_nodes():
    number_of: dict[tuple[int, ...], int] = {}
    for tracks in told_tracks():
        for one in told(tracks):
            identities = [tuple(identity) for identity in one.report.identity.tolist()]
            for identity, number in zip(identities, one.numbers, strict=True):
                assert number_of.setdefault(identity, number) == number
    assert len(set(number_of.values())) == len(number_of)
    colours = [track_colour(number, True) for number in range(1, 11)]
    assert len(set(colours)) == 10


def test_the_scene_draws_a_cross_in_the_colour_of_each_track():
    server = PageServer("127.0.0.1", 0).server
    try:
        plant: Any = Scene(server.scene, RUN.stage, DARK, None).plant
        frame, tracks = RUN.frames[-1], told_tracks()[-1].nodes[2]
        assert RUN.stage.picture is PlantDrawing.OWN
        assert tracks is not None and tracks.numbers
        plant.draw(View(selected=2), frame, RUN.frames)()
        segments, colours = plant._crosses(View(selected=2), tracks)
        each = len(segments) // len(tracks.numbers)
        for place, number in enumerate(tracks.numbers):
            middle = segments[place * each].mean(axis=0)[:2]
            assert middle == pytest.approx(RUN.stage.in_scene(tracks.report.mean[place, ::2])[:2])
            assert tuple(colours[place * each, 0]) == track_colour(number, True)
        shown = [label.text for label in plant._labels if label.visible]
        assert shown == [f"T{number}" for number in tracks.numbers]
    finally:
        server.stop()


def test_the_chart_has_the_mean_and_the_worst_of_the_nodes():
    history = FrameHistory(RUN.stage)
    history.add(RUN.frames)
    view = View(step=RUN.frames[-1].step)
    sample = sampled(RUN.stage, view, history, nothing_expected)
    mean, worst = (line.column(sample) for line in track_charts()[0].lines)
    each = np.array([tracks.gospa_m for tracks in told_tracks()])
    np.testing.assert_allclose(mean, each.mean(axis=1))
    np.testing.assert_allclose(worst, each.max(axis=1))


def test_the_page_shows_the_number_of_targets_and_gospa():
    trace, frames = read_trace(RUN.stage.setup, RUN.messages), RUN.frames
    assert (RUN.stage.score.unit, RUN.stage.error_name, RUN.stage.place) == ("m", "GOSPA", ())
    assert [frame.truth.tolist() for frame in frames] == trace.truth.tolist()
    off = np.abs(trace.mean - trace.truth[:, None])[..., 0]
    np.testing.assert_allclose([frame.scores.error for frame in frames], off)
    assert trace.extra is not None
    gospa_m = np.sqrt((trace.extra.distances() ** 2).mean(axis=1))
    np.testing.assert_allclose([frame.scores.rmse for frame in frames], gospa_m)
