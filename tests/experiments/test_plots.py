"""Pictures and pages: all that a result has enough for, readable as text where they are text."""

import re
from pathlib import Path

import pytest

from concord.experiments.__main__ import main
from concord.experiments.results.palette import COLOURS
from concord.experiments.sweep.run import begin, finish
from concord.experiments.sweep.specification import specify
from concord.experiments.sweep.workers import in_this_process
from tests.experiments.flexray_support import concord, refused

ASKED = {"scenario": "target-tracking", "nodes": "6", "steps": "24", "graph": "ring,complete",
         "rule": "ci,wac", "occupancy": "1,.5"}  # fmt: skip


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plots") / "s.nc"
    finish(begin(specify(ASKED, runs=2), path), in_this_process, lambda _: None)
    return path


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
    assert names == {"error-over-time", "consistency", "network-map", "share-ages"}
    main(["report", str(folder)])
    assert "<table>" in (folder / "report.html").read_text(encoding="utf-8")


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
