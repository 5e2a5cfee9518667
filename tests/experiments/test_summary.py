"""The figures of a run against loops over its trace, and what people and machines are shown."""

import json
import re
from contextlib import suppress
from io import StringIO
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray
from rich.console import Console

from concord.experiments.__main__ import main
from concord.results.figures.intervals import Interval
from concord.results.figures.summary import Summary
from concord.results.figures.summary_table import lines, opening, table
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.runtime.recording import read_recording
from tests.experiments.support import small, summary_of

SETUP = small(steps=30, nodes=4)
TRACE = read_trace(SETUP, in_memory(SETUP))
FIGURES = summary_of(SETUP, TRACE)
FIRST = 20  # where the oscillator begins to be scored


def position_rmse(errors) -> float:
    values = list(errors)
    return float(np.sqrt(sum(e * e for e in values) / len(values)))


def test_errors_are_those_of_the_position_from_the_first_scored_step():
    for node, figures in enumerate(FIGURES.nodes):
        expected = position_rmse(
            TRACE.mean[k, node, 0] - TRACE.truth[k, 0] for k in range(FIRST, 30)
        )
        assert figures["rmse"].value == pytest.approx(expected, rel=1e-12)
    every = position_rmse(
        TRACE.mean[k, i, 0] - TRACE.truth[k, 0] for k in range(FIRST, 30) for i in range(4)
    )
    assert FIGURES.value("rmse") == pytest.approx(every, rel=1e-12)
    assert (FIGURES.first_step, FIGURES.steps, FIGURES.unit) == (FIRST, 30, "m")


def test_consistency_is_of_the_whole_state():
    total = 0.0
    for k in range(FIRST, 30):
        for i in range(4):
            error = TRACE.mean[k, i] - TRACE.truth[k]
            total += error @ np.linalg.solve(TRACE.cov[k, i], error) / 2
    assert FIGURES.value("anees") == pytest.approx(total / 40, rel=1e-9)


def test_traffic_is_that_of_the_last_estimates():
    assert [node["sent"].value for node in FIGURES.nodes] == [90] * 4
    assert [node["heard"].value for node in FIGURES.nodes] == [180] * 4
    assert FIGURES.value("shares_sent") == 360
    assert FIGURES.value("shares_missed") == 0
    assert FIGURES.noticed == {}


def test_what_nodes_notice_of_faults_is_said():
    setup = small(steps=30, nodes=4, changes=("10 missing 1 1", "20 duplicate 1 2 3"))
    figures = summary_of(setup, read_trace(setup, in_memory(setup)))
    assert figures.noticed == {"silent": 20 * 3, "repeated": 10 * 3 * 2}
    assert figures.value("shares_missed") == 20 * 3 * 2
    assert "nodes noticed: repeated 60, silent 60" in lines(figures)


def test_nothing_is_scored_before_anybody_has_seen_anything():
    blind = TRACE.readings.copy()
    blind[:25] = np.nan
    assert summary_of(SETUP, TRACE._replace(readings=blind)).first_step == 25
    blind[:] = np.nan
    assert summary_of(SETUP, TRACE._replace(readings=blind)).first_step == FIRST


@pytest.mark.parametrize("steps", [1, 2, 21])
def test_a_run_of_a_few_steps_has_figures_too(steps: int):
    setup = small(steps=steps)
    figures = summary_of(setup, read_trace(setup, in_memory(setup)))
    assert figures.first_step == min(FIRST, steps - 1)
    assert np.isfinite(figures.value("rmse"))


def test_truth_that_nobody_knows_is_left_out():
    truth = TRACE.truth.copy()
    truth[22:26] = np.nan
    figures = summary_of(SETUP, TRACE._replace(truth=truth))
    known = [k for k in range(FIRST, 30) if not 22 <= k < 26]
    expected = position_rmse(TRACE.mean[k, 0, 0] - TRACE.truth[k, 0] for k in known)
    assert figures.nodes[0]["rmse"].value == pytest.approx(expected, rel=1e-12)


# --- what is shown -------------------------------------------------------------------------------


def shown(figures: Summary) -> str:
    console = Console(markup=False, width=100, record=True, file=StringIO())
    console.print(table(figures, "a title"))
    return console.export_text() + "\n".join(lines(figures))


def test_the_table_has_a_row_for_each_node_and_frames_the_network():
    text = shown(FIGURES)
    for heading in ("node", "RMSE [m]", "alone [m]", "ANEES", "sent", "heard", "missed"):
        assert heading in text
    for figures in FIGURES.nodes:
        assert f"{figures['rmse'].value:.4g}" in text
    assert f"{FIGURES.value('rmse_centralised'):.4g}" in text
    assert "scored from step 20 of 30" in text


def test_no_name_is_cut_at_eighty_columns():
    console = Console(markup=False, width=80, record=True, file=StringIO())
    long = {"rmse": 0.001299, "rmse_alone": 0.001884, "sent": 540000.0, "heard": 180000.0}
    wide = {name: Interval(value, np.nan, np.nan) for name, value in long.items()}
    nodes = [node | wide for node in FIGURES.nodes]
    for figures in (FIGURES, msgspec.structs.replace(FIGURES, unit="rad", nodes=nodes)):
        console.print(table(figures, "./a[b].py:CAR"))
    text = console.export_text()
    assert "centralised" in text and "rejected" in text and "…" not in text
    assert "./a[b].py:CAR" in text


def test_the_verdict_opens_the_figures_in_lines_of_eighty_characters():
    said = opening(FIGURES, SETUP.scenario, "processes")
    assert said[0].startswith("CHECK  too short")  # ten scored steps have no interval
    assert "use --steps 40" in " ".join(" ".join(said).split())
    assert max(map(len, said)) <= 80
    longer = small(steps=80, nodes=4)
    said = opening(summary_of(longer, read_trace(longer, in_memory(longer))), longer.scenario, "x")
    assert said[0] == "WORKS  4 nodes took 80 steps; no frame was missed or rejected."
    text = " ".join(" ".join(said).split())
    assert re.search(
        r"error \S+ m in the network, \S+ m for a node alone, \S+ m for one filter", text
    )
    assert "honesty cautious: nodes claim errors" in text and "every node sends" in text


def test_what_is_not_known_is_a_dash_in_the_table():
    unknown = TRACE._replace(truth=np.full_like(TRACE.truth, np.nan))
    assert " - " in shown(summary_of(SETUP, unknown))


@pytest.fixture
def run_json(tmp_path: Path, monkeypatch, capsys: pytest.CaptureFixture[str]):
    """`concord run --json` and what it wrote: standard output, standard error, folder."""
    monkeypatch.chdir(tmp_path)

    def run(options: str) -> tuple[str, str, Path]:
        # A log in whose first steps no node reads anything is no run that works.
        with suppress(SystemExit):
            main(["run", *options.split(), "--json", "--out", "run"])
        captured = capsys.readouterr()
        return captured.out, captured.err, tmp_path / "run"

    return run


SMALL_RUN = "--scenario oscillator --nodes 3 --graph path --steps 25 --seed 5"


def test_json_is_one_object_on_standard_output_and_notes_go_elsewhere(run_json):
    out, err, folder = run_json(SMALL_RUN)
    assert out.count("\n") == 1
    figures = json.loads(out)
    assert (figures["steps"], len(figures["nodes"])) == (25, 3)
    assert err.startswith("seed 5; results in run\n")
    assert '"of":"oscillator","done":25,"total":25' in err
    assert {entry.name for entry in folder.iterdir()} >= {"run.json", "run.mcap", "run.nc"}


def test_what_is_said_follows_from_what_is_recorded(run_json):
    out, _, folder = run_json(SMALL_RUN)
    setup = small(nodes=3, graph="path", steps=25, seed=5)
    trace = read_trace(setup, read_recording(folder / "run.mcap"))
    expected = json.loads(summary_of(setup, trace).as_json())
    said = json.loads(out)
    for name in ("steps_per_second", "ready_s", "repeated_messages", "labelled"):
        said.pop(name, None)
    assert said == expected
    with xarray.open_dataset(folder / "run.nc", engine="h5netcdf") as dataset:
        error = (dataset["mean"] - dataset.truth).sel(state="x", run=0)
        rmse = np.sqrt((error.isel(step=slice(20, None)) ** 2).mean("step"))
        np.testing.assert_allclose(rmse, [n["rmse"][0] for n in said["nodes"]], rtol=1e-12)


def test_listing_for_machines_and_people_names_the_same(capsys: pytest.CaptureFixture[str]):
    main(["list", "--json"])
    everything = json.loads(capsys.readouterr().out)
    main(["list"])
    shown_to_people = capsys.readouterr().out
    for name in (*everything["scenarios"], *everything["rules"], *everything["graphs"]):
        assert name in shown_to_people
