"""Test what users put into papers: LaTeX and CSV tables, pictures of a width, names as written."""

import csv
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import LineCollection

from concord.experiments.cli.plot import figures_of
from concord.studies.sweep.results import read_result
from concord.studies.sweep.summary import figures_of as summary_of
from tests.experiments.command_support import concord, refused

RULE = """
import numpy as np
from concord.filters.gaussian import Gaussian

def CAR(beliefs, weights):
    "The belief with the greatest weight."
    first = weights.argmax(-1)[..., None, None]
    mean = np.take_along_axis(beliefs.mean, first, -2)[..., 0, :]
    return Gaussian(mean, np.take_along_axis(beliefs.cov, first[..., None], -3)[..., 0, :, :])
"""
ASKED = ["--scenario", "oscillator", "--nodes", "3", "--steps", "12", "--workers", "1"]


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep whose result was asked for as s.csv."""
    folder = tmp_path_factory.mktemp("files")
    from concord.experiments.__main__ import main

    main(["sweep", *ASKED, "--graph", "ring,path", "--occupancy", "1,.5", "--runs", "3",
          "-o", str(folder / "s.csv")])  # fmt: skip
    return folder


def test_a_csv_has_a_row_of_values_for_each_cell(swept: Path):
    figures = summary_of(read_result(swept / "s.nc"))
    with (swept / "s.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["graph"], row["occupancy"]) for row in rows] == [
        ("ring", "1.0"), ("ring", "0.5"), ("path", "1.0"), ("path", "0.5"),
    ]  # fmt: skip
    for row, cell in zip(rows, figures.cells, strict=True):
        assert row["unit"] == "m"
        low, high = row["anees_low"], row["anees_high"]
        assert (float(row["anees"]), float(low), float(high)) == tuple(cell["anees"])
        assert np.isnan(cell["settling_steps"].low) == (row["settling_steps_low"] == "")


@pytest.mark.usefixtures("blank_pictures")
def test_a_sweep_has_a_latex_table_with_its_intervals(
    swept: Path, capsys: pytest.CaptureFixture[str]
):
    out = swept / "t.tex"
    asked = ["report", swept / "s.nc", "-o", out, "--columns", "rmse,anees,bytes_per_step"]
    assert concord(capsys, *asked).code == 0
    lines = [line for line in out.read_text().splitlines() if not line.startswith("%")]
    assert lines[:4] == [
        r"\begin{tabular}{lllrrr}", r"\toprule",
        r"graph & occupancy & level & rmse [m] & anees & bytes per step \\", r"\midrule",
    ]  # fmt: skip
    assert lines[-2:] == [r"\bottomrule", r"\end{tabular}"]
    first = summary_of(read_result(swept / "s.nc")).cells[0]
    rmse = f"{first['rmse'].value:.4g} {first['rmse'].spread()}".replace("±", r"$\pm$")
    assert lines[4].startswith(rf"ring & 1 & {first.level} & {rmse} & ")
    assert r"\usepackage{booktabs}" in out.read_text()
    told = refused(concord(capsys, *asked[:-1], "rms"))
    assert "unknown figure of --columns 'rms': did you mean 'rmse'?" in told


def test_pictures_get_the_width_of_a_column_and_no_title(
    swept: Path, capsys: pytest.CaptureFixture[str]
):
    asked = ["plot", swept / "s.nc", "--width", "88mm", "--no-title", "--out", swept / "narrow"]
    said = concord(capsys, *asked, "--json")
    for path in map(Path, json.loads(said.out)["pictures"]):
        height, width = plt.imread(path).shape[:2]
        assert width == pytest.approx(88 / 25.4 * 300, abs=1) and height > 600
    wrong = refused(concord(capsys, "plot", swept / "s.nc", "--width", "88"))
    assert "--width 88: must be a number above 0 with its unit (mm, cm, in or pt)" in wrong


def test_the_front_has_the_interval_of_each_cell(swept: Path):
    figure = figures_of(swept / "s.nc")["pareto"]
    intervals = [cell["to_centralised"] for cell in summary_of(read_result(swept / "s.nc")).cells]
    bars = [one for one in figure.axes[0].collections if isinstance(one, LineCollection)]
    drawn = [np.asarray(bar.get_segments()[0])[:, 1] for bar in bars]
    plt.close("all")
    assert np.allclose(drawn, [(one.low, one.high) for one in intervals])


@pytest.mark.usefixtures("blank_pictures")
def test_names_stand_in_tables_and_sentences_as_they_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.chdir(tmp_path)
    Path("a[b]:car:c.py").write_text(RULE)
    rule = "./a[b]:car:c.py:CAR"
    run = ["run", *ASKED[:-2], "--rule", rule]
    assert f"{rule}, " in concord(capsys, *run, "--out", "[one]").out
    assert f"{rule}, " in concord(capsys, *run, "--driver", "batched", "--out", "many").out
    said = concord(capsys, "sweep", *ASKED, "--rule", f"{rule},ci", "--runs", 2, "-o", "[s].nc")
    assert f" {rule} " in said.out and "result in [s].nc; `concord plot [s].nc`" in said.out
    assert "[s]-plots/pareto.png" in concord(capsys, "plot", "[s].nc").out
