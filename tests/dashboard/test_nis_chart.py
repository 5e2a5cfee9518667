"""Test NIS in the dashboard: the numbers of run.nc, step by step, and the chart that shows them."""

import numpy as np
import pytest
from scipy.special import chdtri

from concord.dashboard.frames.assembler import Assembler
from concord.dashboard.frames.expected import nothing_expected
from concord.dashboard.frames.innovations import StepNis
from concord.dashboard.panels.chart import Sample
from concord.dashboard.panels.nis_chart import nis_chart
from concord.dashboard.view import View
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.whole_steps import WholeSteps
from tests.dashboard.runs import run_of


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("target-tracking", {"nodes": 6, "steps": 24}),
        ("dc-motor-speed", {"nodes": 4, "steps": 12}),
        ("vehicle-network", {"steps": 40}),
        ("oscillator", {"nodes": 4, "steps": 16, "changes": ("4 kill 1", "9 restart 1")}),
    ],
)
def test_frames_have_the_nis_of_the_run(name: str, options: dict):
    run = run_of(name, **options)
    found = runs_of_trace(run.stage.setup, read_trace(run.stage.setup, run.messages)).innovations
    assert found is not None
    nis, entries = found.nis[0], found.entries[0]
    for frame in run.frames:
        told = frame.scores.nis
        assert told is not None
        np.testing.assert_allclose(told.squares, np.nansum(nis[frame.step], axis=-1), rtol=1e-9)
        np.testing.assert_array_equal(told.freedoms, entries[frame.step].sum(axis=-1))


def test_the_chart_has_nodes_the_selected_one_and_their_bounds():
    run = run_of("oscillator", nodes=4, steps=30)
    frames = run.frames
    times = np.array([frame.time_s for frame in frames])
    for selected in (None, 2, 3):  # node 3 is blind
        view = View(selected=selected)
        sample = Sample(run.stage, view, frames, times, nothing_expected(times))
        nodes, own, low, high = (line.column(sample) for line in nis_chart().lines)
        assert np.isfinite(nodes).all() and (low < 1).all() and (high > 1).all()
        assert np.isfinite(own).all() == (selected == 2)
        assert ((low < nodes) & (nodes < high)).mean() > 0.7


def test_a_step_that_was_left_out_has_no_nis_after_it():
    run = run_of("oscillator", nodes=4, steps=10)
    together = WholeSteps(run.stage.nodes, run.stage.rounds, run.stage.bus.frame_format)
    steps = [step for message in run.messages for step in together.take(*message)]
    assembler = Assembler(run.stage)
    frames = [assembler.frame(step) for step in steps if step.number != 5]
    nis = {frame.step: frame.scores.nis for frame in frames if frame is not None}
    told = nis[6]
    assert told is not None and not told.freedoms.any() and np.isnan(told.of(0))
    after = nis[7]
    assert after is not None and after.freedoms.sum() == 3


@pytest.mark.parametrize(("line", "tail"), [(2, 0.025), (3, 0.975)])
def test_the_bounds_are_those_of_chi_square(line: int, tail: float):
    run = run_of("oscillator", nodes=4, steps=3)
    frame = run.frames[-1]
    for freedom in (3, 4, 9, 48, 400):
        told = StepNis(np.zeros(4), np.array([freedom, 0, 0, 0]))
        shown = frame._replace(scores=frame.scores._replace(nis=told))
        sample = Sample(run.stage, View(), [shown], np.zeros(1), nothing_expected(np.zeros(1)))
        (bound,) = nis_chart().lines[line].column(sample)
        assert abs(bound - chdtri(freedom, 1 - tail) / freedom) < 0.012
