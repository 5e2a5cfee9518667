"""Compare each series that a browser receives with run.nc: equal where known, gaps elsewhere."""

import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5netcdf
import numpy as np
import pytest

from concord.dashboard.comparison.compared_charts import compared_charts
from concord.dashboard.comparison.other_run import OtherRun, running_mean
from concord.dashboard.frames.expected import nothing_expected
from concord.dashboard.frames.history import FrameHistory
from concord.dashboard.frames.source import RecordedSource
from concord.dashboard.frames.stage import Stage, set_stage
from concord.dashboard.panels.chart import Chart
from concord.dashboard.panels.chart_table import run_charts, state_charts
from concord.dashboard.panels.charts import Charts, sampled
from concord.dashboard.theme import DARK
from concord.dashboard.view import View
from concord.results.figures.intervals import ratio_t
from concord.results.folder import read_description
from tests.processes import CONCORD

STEPS, NODE = 40, 1
RUNS = {
    "faults": ("--rule", "ci", "--changes", "8 kill 1", "20 restart 1", "24 cut 0 2"),
    "other": ("--rule", "hcmci"),
    "unknown": ("--rule", "ci", "--changes", "5 kill 1", "9 kill 2", "12 kill 3"),
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the folders of three runs of one truth."""
    parent = tmp_path_factory.mktemp("runs")
    usual = ("--nodes", "4", "--seed", "3", "--steps", str(STEPS), "--schedule", "full")
    for name, options in RUNS.items():
        run = [*CONCORD, "run", *usual, *options, "--out", str(parent / name)]
        subprocess.run(run, check=True, capture_output=True)
    return {name: parent / name for name in RUNS}


class Written:
    """The gui of a page that keeps what it is told."""

    def __init__(self) -> None:
        self.plots: list[Any] = []

    def add_html(self, *_: Any, **__: Any) -> Any:
        return SimpleNamespace()

    def add_uplot(self, **properties: Any) -> Any:
        self.plots.append(SimpleNamespace(**properties, visible=True))
        return self.plots[-1]


class Nowhere:
    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


def loaded(folder: Path) -> tuple[Stage, RecordedSource]:
    stage = set_stage(read_description(folder).setup)
    return stage, RecordedSource(stage, folder / "run.mcap")


def received(
    stage: Stage, history: FrameHistory, charts: tuple[Chart, ...]
) -> dict[str, dict[str, list[float | None]]]:
    """Return title -> name of a line -> what a browser receives of it; the times are "time [s]"."""
    gui: Any = Written()
    view = View(step=STEPS - 1, selected=NODE)
    Charts(gui, Nowhere(), charts, DARK, 80).draw(sampled(stage, view, history, nothing_expected))
    return {
        plot.title: {
            one["label"]: values for one, values in zip(plot.series, plot.data, strict=True)
        }
        for plot in gui.plots
    }


class Record:
    """The arrays of run.nc, run 0."""

    def __init__(self, folder: Path) -> None:
        with h5netcdf.File(folder / "run.nc") as file:
            known = {name: np.array(file[name]) for name in file.variables}
        self.truth, self.mean, self.cov = (known[name][0] for name in ("truth", "mean", "cov"))
        self.nees = _mean(known["nees"][0])
        self.payload_bytes = known["payload_bytes"][0].sum((1, 2))
        entries = np.isfinite(known["innovation"][0]).sum((2, 3))
        squares = np.nansum(known["nis"][0], axis=2)
        with np.errstate(invalid="ignore"):
            self.nis = squares.sum(1) / entries.sum(1)
            self.nis_of_node = squares[:, NODE] / entries[:, NODE]

    def rmse(self, states: tuple[int, ...]) -> np.ndarray:
        off = (self.mean - self.truth[:, None])[..., list(states)]
        return np.sqrt(_mean((off**2).sum(-1)))


def _mean(values: np.ndarray) -> np.ndarray:
    """Return the mean (T,) of what is known (T, N), NaN where nothing is."""
    known = np.isfinite(values)
    count = known.sum(1)
    return np.where(count > 0, np.where(known, values, 0).sum(1) / np.maximum(count, 1), np.nan)


def equal(came: list[float | None], wanted: np.ndarray, steps: np.ndarray) -> None:
    """Assert numbers where the record has numbers, and gaps elsewhere."""
    gaps = np.array([value is None for value in came])
    np.testing.assert_array_equal(gaps, ~np.isfinite(wanted[steps]))
    numbers = np.array([value for value in came if value is not None])
    np.testing.assert_allclose(numbers, wanted[steps][~gaps], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", RUNS)
def test_every_series_is_that_of_the_record_with_gaps_elsewhere(
    folders: dict[str, Path], name: str
):
    stage, source = loaded(folders[name])
    history = FrameHistory(stage)
    history.add(source.poll())
    history.add(source.poll())
    assert len(history) == STEPS
    record, states = Record(folders[name]), stage.score.states
    plots = received(stage, history, (*run_charts(stage), *state_charts()))
    by_start = {title.split(" [")[0].split(" · ")[0]: lines for title, lines in plots.items()}

    def line(title: str, label: str) -> tuple[list[float | None], np.ndarray]:
        lines = next(by_start[one] for one in by_start if one.startswith(title))
        times = np.array(lines["time [s]"], dtype=float)
        return lines[label], np.round(times / stage.setup.time_step_s).astype(int)

    kilo = 1e3 if any("[kB/s]" in title for title in plots) else 1.0
    reach = 3 * np.sqrt(record.cov[:, NODE, 0, 0])
    mean = record.mean[:, NODE, 0]
    wanted = {
        ("RMSE", "nodes"): record.rmse(states),
        ("NEES", "NEES"): record.nees,
        ("NIS", "nodes"): record.nis,
        ("NIS", "selected"): record.nis_of_node,
        ("Payload", "payload"): record.payload_bytes / stage.setup.time_step_s / kilo,
        ("x, node", "truth"): record.truth[:, 0],
        ("x, node", "node"): mean,
        ("x, node", "+3σ"): mean + reach,
        ("x, node", "−3σ"): mean - reach,
        ("error of x", "error"): mean - record.truth[:, 0],
        ("error of x", "+3σ"): reach,
    }
    for (title, label), values in wanted.items():
        if not np.isfinite(values[stage.score.first_step :]).any():
            # A line without a value is left out.
            continue
        came, steps = line(title, label)
        equal(came, values, steps)


def test_the_difference_of_two_runs_is_known_where_both_are_and_has_a_band_later(
    folders: dict[str, Path],
):
    stage, source = loaded(folders["faults"])
    history = FrameHistory(stage)
    history.add(source.poll())
    other = OtherRun(loaded(folders["other"])[1], ("ci", "hcmci"), ratio_t)
    other.poll()
    plots = received(stage, history, compared_charts(run_charts(stage), other, history))
    lines = next(plot for title, plot in plots.items() if "hcmci less ci" in title)
    first, second = (Record(folders[name]).rmse(stage.score.states) for name in ("faults", "other"))
    steps = np.round(np.array(lines["time [s]"], float) / stage.setup.time_step_s).astype(int)
    scored = np.arange(stage.score.first_step, STEPS)
    difference, low, mean = (np.full(STEPS, np.nan) for _ in range(3))
    difference[scored] = (second - first)[scored]
    mean[scored], low[scored], _ = running_mean(difference[scored])
    equal(lines["of the step"], difference, steps)
    equal(lines["mean so far"], mean, steps)
    equal(lines["95 % from"], low, steps)
    assert None in lines["95 % from"]
