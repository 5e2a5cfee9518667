"""`concord new`: a study passes its own tests, and nothing is written for a bad request."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from concord.experiments.cli import new
from concord.experiments.cli.command_line import main
from tests.pages import ROOT

pytestmark = pytest.mark.slow

FILES = {"Makefile", "README.md", "figure.py", "plant.py", "rule.py", "test_study.py"}


@pytest.mark.zenoh
def test_a_study_runs_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    main(["new", "carts-2"])
    study = tmp_path / "carts-2"
    assert {file.name for file in study.iterdir()} == FILES
    assert [*tmp_path.iterdir()] == [study]
    assert (study / "README.md").read_text().startswith("# carts-2\n")
    environment = {key: value for key, value in os.environ.items() if key != "PYTEST_ADDOPTS"}
    for target in ("test", "sweep", "figure"):
        done = subprocess.run(
            ["make", f"PYTHON={sys.executable}", "RUNS=2", target],
            cwd=study, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
    assert (study / "sweep.nc").is_file() and (study / "figure.png").is_file()


@pytest.mark.parametrize("name", ["", "../up", "a b", "1st", "a/b", ".hidden", "a;b"])
def test_a_bad_name_is_refused(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["new", name])
    assert ended.value.code == 2 and "must begin with a letter" in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


def test_a_place_that_is_taken_stays_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study").mkdir()
    (tmp_path / "gone").symlink_to("nowhere")
    for name in ("study", "gone"):
        with pytest.raises(SystemExit) as ended:
            main(["new", name])
        assert ended.value.code == 2 and "is there already" in capsys.readouterr().err
    assert not [*(tmp_path / "study").iterdir()]


def test_a_full_disk_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    written = Path.write_text

    def full(file: Path, text: str, encoding: str) -> int:
        if file.name == "rule.py":
            raise OSError(28, "No space left on device")
        return written(file, text, encoding)

    monkeypatch.setattr(new.Path, "write_text", full)
    with pytest.raises(SystemExit) as ended:
        main(["new", "study"])
    assert ended.value.code == 1 and "No space left" in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


def test_the_wheel_has_the_files_of_a_study(tmp_path: Path):
    command = [sys.executable, "-m", "pip", "wheel", str(ROOT), "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "-q", "-w", str(tmp_path)], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {Path(name).stem for name in names if name.endswith(".template")} == FILES
