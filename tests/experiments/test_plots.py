"""Pictures and pages: all that a result has enough for, readable as text where they are text."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray

from concord.experiments.__main__ import main
from concord.results.palette import COLOURS
from concord.results.records.netcdf_file import write_dataset
from concord.results.run_plots import run_figures
from concord.studies.design.results import read_design
from concord.studies.sweep.run import begin, finish
from concord.studies.sweep.specification import specify
from concord.studies.sweep.workers import in_this_process
from tests.experiments.command_support import concord, refused

pytestmark = pytest.mark.slow

ASKED = {"scenario": "target-tracking", "nodes": "6", "steps": "24", "graph": "ring,complete",
         "rule": "ci,wac", "occupancy": "1,.5"}  # fmt: skip


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plots") / "s.nc"
    finish(begin(specify(ASKED, runs=2), path), in_this_process, lambda _: None)
    return path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a run, and one of two batched runs."""
    folder = tmp_path_factory.mktemp("runs")
    asked = ["run", "--scenario", "oscillator", "--nodes", "3", "--steps", "4"]
    main([*asked, "--out", str(folder / "one")])
    main([*asked, "--driver", "batched", "--runs", "2", "--out", str(folder / "two")])
    return folder


def test_a_sweep_has_all_its_pictures(result: Path, capsys: pytest.CaptureFixture[str]):
    main(["plot", str(result), "--format", "svg"])
    names = {Path(line).stem for line in capsys.readouterr().out.split()}
    assert names == {"error-over-time", "error-against", "heat-map", "pareto", "network-map"}
    for line in (result.with_name("s-plots")).iterdir():
        assert line.stat().st_size > 3000
    lines = (result.with_name("s-plots") / "error-against.svg").read_text(encoding="utf-8")
    assert {c.lower() for c in COLOURS[:2]} <= set(re.findall(r"#[0-9a-f]{6}", lines))


def test_equal_results_give_equal_pictures(result: Path, tmp_path: Path):
    for folder in ("one", "two"):
        main(["plot", str(result), "--format", "svg", "-o", str(tmp_path / folder)])
    for picture in (tmp_path / "one").iterdir():
        assert picture.read_bytes() == (tmp_path / "two" / picture.name).read_bytes()


@pytest.mark.parametrize(
    "asked",
    [
        {"graph": "ring"},
        {"seed": "1,2"},
        {"graph": "ring,path", "weights": "metropolis,best-constant"},
        {"determinant_weights": "true,false"},
    ],
)
def test_sweeps_of_anything_can_be_drawn(asked: dict[str, str], tmp_path: Path):
    common = {"scenario": "oscillator", "nodes": "3", "steps": "6"}
    out = tmp_path / "s.nc"
    finish(begin(specify({**common, **asked}, runs=2), out), in_this_process, lambda _: None)
    main(["plot", str(out)])
    assert (tmp_path / "s-plots" / "error-over-time.png").exists()


def test_a_hypercube_can_be_drawn(tmp_path: Path):
    asked = {"scenario": "oscillator", "nodes": "3", "steps": "6", "decay": "0..1",
             "graph": "ring,path"}  # fmt: skip
    out = tmp_path / "s.nc"
    finish(begin(specify(asked, runs=2, samples=4), out), in_this_process, lambda _: None)
    main(["plot", str(out)])
    assert (tmp_path / "s-plots" / "pareto.png").exists()


def test_a_run_has_its_pictures_and_its_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = tmp_path / "run"
    main(["run", "--scenario", "oscillator", "--nodes", "4", "--steps", "8", "--out", str(folder)])
    main(["plot", str(folder)])
    names = {path.stem for path in (folder / "plots").iterdir()}
    expected = {"error-over-time", "consistency", "innovations", "network-map", "share-ages"}
    assert names == expected
    main(["report", str(folder)])
    assert "<table>" in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "asked",
    [
        "oscillator --nodes 4 --steps 24",
        "target-tracking --nodes 4 --steps 22 --rule labelled --schedule dynamic --occupancy .5",
        "liu2021-network --steps 4",
        "dc-motor-speed --steps 12",
    ],
)
def test_many_runs_have_pictures_and_the_page_of_what_was_printed(
    asked: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = tmp_path / "many"
    words = ["--driver", "batched", "--runs", "3", "--out", str(folder)]
    main(["run", "--scenario", *asked.split(), *words])
    printed = " ".join(capsys.readouterr().out.split())
    main(["plot", str(folder / "run.nc")])
    names = {path.stem for path in (folder / "plots").iterdir()}
    of_beliefs = set() if "liu" in asked else {"consistency", "innovations"}
    assert names == {"error-over-time", "network-map", "share-ages"} | of_beliefs
    main(["report", str(folder), "-o", str(tmp_path / "page.md")])
    _, _, *said = (tmp_path / "page.md").read_text(encoding="utf-8").split("\n\n| ")[0].splitlines()
    said = [line for line in said if line and not line.startswith(("Driver", "States"))]
    verdict, *others = said
    assert verdict.partition(":")[0] in printed
    assert len(others) >= 2 and all(line in printed for line in others), said


@pytest.mark.filterwarnings("error")
def test_steps_without_truth_are_not_in_the_pictures_of_errors(tmp_path: Path):
    """A log has its truth at some steps, or at none."""
    asked = "run --scenario oscillator --nodes 3 --steps 22 --out"
    main([*asked.split(), str(tmp_path / "run")])
    for unknown, drawn in ((slice(1, None, 2), [11, 11]), (slice(None), [])):
        with xarray.load_dataset(tmp_path / "run" / "run.nc") as data:
            for name in ("truth", "nees"):
                data[name][:, unknown] = np.nan
        write_dataset(data, tmp_path / "run" / "run.nc")
        figures = run_figures(tmp_path / "run")
        assert {"innovations", "share-ages"} <= set(figures)
        assert ("network-map" in figures) == bool(drawn)
        of_errors = [
            figures[name] for name in ("error-over-time", "consistency") if name in figures
        ]
        shown = [np.asarray(figure.axes[0].lines[0].get_ydata()) for figure in of_errors]
        assert [len(values) for values in shown] == drawn
        for figure in figures.values():
            plt.close(figure)


def test_pictures_of_many_runs_are_of_all_of_them(tmp_path: Path):
    """One run among many is drawn as it is alone, if the others have the same numbers."""
    folder = tmp_path / "many"
    asked = ["run", "--scenario", "oscillator", "--nodes", "3", "--steps", "22"]
    main([*asked, "--driver", "batched", "--runs", "2", "--out", str(folder)])
    main([*asked, "--out", str(tmp_path / "one")])
    with xarray.load_dataset(folder / "run.nc") as data:
        twice = data.isel(run=[0, 0]).assign_coords(run=data["run"])
    write_dataset(twice, folder / "run.nc")
    of_both, of_one = (run_figures(path) for path in (folder, tmp_path / "one"))
    for name in ("error-over-time", "consistency"):
        drawn, alone = (figures[name].axes[0].lines for figures in (of_both, of_one))
        for line, expected in zip(drawn, alone, strict=True):
            both, one = np.asarray(line.get_ydata()), np.asarray(expected.get_ydata())
            np.testing.assert_allclose(both, one, rtol=1e-8)


def test_a_design_has_its_pictures_and_its_page(tmp_path: Path):
    out = tmp_path / "design.json"
    asked = "--scenario oscillator --nodes 3 --steps 24 --graph ring --weights metropolis --rule ci"
    limits = "--rounds 1 --schedule full --number float64,float32 --runs 4 --target-rmse 9"
    main(["design", *asked.split(), *limits.split(), "-o", str(out)])
    main(["plot", str(out)])
    assert {path.stem for path in (tmp_path / "design-plots").iterdir()} == {"front"}
    main(["report", str(out), "-o", str(tmp_path / "page.md")])
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    front = [one for one in read_design(out).tried if one.front]
    assert front
    for one in front:
        costs = " | ".join(f"{cost:.4g}" for cost in one.costs.values())
        assert f"| {costs} | {one.runs} |" in page


def test_a_smoothed_run_has_its_errors_by_lag(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """In the figures, in the file, in many runs and in a picture; all say the same."""
    folder, many = tmp_path / "run", tmp_path / "many"
    asked = ["run", "--scenario", "oscillator", "--nodes", "4", "--rule", "labelled",
             "--occupancy", "0.25", "--steps", "40", "--smooth-steps", "6"]  # fmt: skip
    main([*asked, "--json", "--out", str(folder)])
    figures = json.loads(capsys.readouterr().out)["smoothed"]
    assert [one["lag"] for one in figures] == list(range(7))
    # The past is known better than the present, and to the smoother that hears everything best.
    assert figures[6]["rmse"][0] < figures[0]["rmse"][0]
    file = xarray.load_dataset(folder / "run.nc", engine="h5netcdf").isel(run=0)
    # States are scored from step 20 on, and six steps later they are six steps old.
    off = file.smoothed_mean.isel(lag=6)[26:].to_numpy() - file.truth[20:34].to_numpy()[:, None]
    assert figures[6]["rmse"][0] == pytest.approx(np.sqrt((off[..., 0] ** 2).mean()))
    main([*asked, "--driver", "batched", "--runs", "2", "--out", str(many)])
    assert "smoothed, x the centralised smoother" in capsys.readouterr().out
    both = xarray.load_dataset(many / "run.nc", engine="h5netcdf")
    np.testing.assert_allclose(both.smoothed_std[0], file.smoothed_std, rtol=1e-9)
    for one in (folder, many):
        main(["plot", str(one)])
        assert (one / "plots" / "error-against-lag.png").exists()
    capsys.readouterr()
    main(["report", str(many), "-o", str(tmp_path / "page.md")])
    assert "smoothed, x the" in (tmp_path / "page.md").read_text(encoding="utf-8")


def test_a_page_needs_no_other_file(result: Path, tmp_path: Path):
    main(["report", str(result), "-o", str(tmp_path / "s.html")])
    main(["report", str(result), "-o", str(tmp_path / "s.md")])
    page = (tmp_path / "s.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 5
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert page.count("<tr>") == 1 + 8 and "numpy" in page and "&quot;runs&quot;: 2" in page
    text = (tmp_path / "s.md").read_text(encoding="utf-8")
    assert text.startswith("# Sweep of graph, rule, occupancy") and "| ring | ci | 1 |" in text


@pytest.mark.parametrize("command", ["plot", "report"])
def test_what_is_no_result_is_refused(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "x.nc").write_bytes(b"no")
    (tmp_path / "x.json").write_text("{}", encoding="utf-8")
    (tmp_path / "folder").mkdir()
    for name in ("missing.nc", "x.nc", "x.json", "folder"):
        assert name in refused(concord(capsys, command, tmp_path / name))


def _lacking(name: str) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        with h5py.File(path, "a") as file:
            del file[name]

    return damage


def _without(attribute: str) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        with h5py.File(path, "a") as file:
            del file.attrs[attribute]

    return damage


def _cut(share: float) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        whole = path.read_bytes()
        path.write_bytes(whole[: int(share * len(whole))])

    return damage


@pytest.mark.parametrize(
    "damage",
    [_cut(0.0), _cut(0.001), _cut(0.5), _cut(0.99), _lacking("mean"), _lacking("nees"),
     _lacking("time"), _lacking("readings")],
)  # fmt: skip
@pytest.mark.parametrize("command", ["plot", "report"])
def test_damaged_arrays_are_refused_in_a_sentence(
    command: str,
    damage: Callable[[Path], None],
    runs: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    capsys.readouterr()
    for name in ("one", "two"):
        folder = shutil.copytree(runs / name, tmp_path / name)
        damage(folder / "run.nc")
        assert "run.nc: " in refused(concord(capsys, command, folder))


@pytest.mark.parametrize(
    "damage", [_cut(0.5), _lacking("rmse"), _without("specification"), _without("seed")]
)
@pytest.mark.parametrize("command", ["plot", "report"])
def test_a_damaged_sweep_is_refused_in_a_sentence(
    command: str,
    damage: Callable[[Path], None],
    result: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    (tmp_path / "s.nc").write_bytes(result.read_bytes())
    damage(tmp_path / "s.nc")
    assert "s.nc: " in refused(concord(capsys, command, tmp_path / "s.nc"))


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("neighbours", [[1, 2], [0, 99], [0, 1]]),
        ("neighbours", [[1, 2], [0, -1], [0, 1]]),
        ("neighbours", [[1, 2], [0, 2]]),
        ("neighbours", [[0, 2], [0, 2], [0, 1]]),
        ("weights", [[1.0]]),
        ("prior_cov", [[1.0, 0.0], []]),
        ("prior_mean", [0.0]),
    ],
)
@pytest.mark.parametrize("command", ["plot", "report"])
def test_a_description_of_no_network_is_refused(
    command: str,
    part: str,
    value: Any,
    runs: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    folder = _described(runs, tmp_path, lambda setup: setup.update({part: value}))
    capsys.readouterr()
    assert "run.json: not the description of a run" in refused(concord(capsys, command, folder))


def _described(runs: Path, above: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """A copy of the run whose description has another setup."""
    folder = shutil.copytree(runs / "one", above / "run")
    described = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    change(described["setup"])
    (folder / "run.json").write_text(json.dumps(described), encoding="utf-8")
    return folder


def test_a_word_without_end_is_not_quoted_whole(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    word = {"type": "x" * 100_000}
    folder = _described(runs, tmp_path, lambda setup: setup["scenario"]["filter"].update(word))
    capsys.readouterr()
    assert len(refused(concord(capsys, "plot", folder))) < 2000


@pytest.mark.parametrize("command", ["plot", "report"])
def test_a_result_that_is_not_there_may_be_of_a_run_or_of_a_sweep(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    said = refused(concord(capsys, command, tmp_path / "nowhere"))
    assert "does not exist; name the folder of a run, or the file that `concord sweep`" in said
