"""Test user errors: one line with name and cure, exit code 2, and no unfinished files."""

import shutil
from pathlib import Path

import pytest

from concord.experiments.__main__ import main
from concord.experiments.results.folder import RECORDING
from tests.experiments.flexray_support import concord, refused
from tests.processes import PROC


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder.parent)
        main(["run", "--scenario", "oscillator", "--nodes", "3", "--steps", "3", "--out", "run"])
    return folder


@pytest.fixture
def home(tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a run in it to work in."""
    shutil.copytree(finished, tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def complaint(home: Path, capsys: pytest.CaptureFixture[str]):
    """Return the message of a refused command; check its exit and that it made no files."""

    def said(arguments: str) -> str:
        before = sorted(home.rglob("*"))
        message = refused(concord(capsys, *arguments.split()))
        assert sorted(home.rglob("*")) == before
        return message

    return said


@pytest.mark.parametrize("command", ["replay run", "dashboard --folder run"])
@pytest.mark.parametrize(
    ("place", "says"),
    [
        ("--http-port -1", "--http-port -1: must be 1 to 65535, or 0 for any free one"),
        ("--http-port 65536", "--http-port 65536: must be 1 to 65535"),
        # An address for documentation (RFC 5737), which no machine has.
        ("--host 192.0.2.1", "--host 192.0.2.1: this machine cannot listen there"),
        ("--host no.such.host.invalid", "--host no.such.host.invalid: this machine cannot listen"),
    ],
)
def test_a_page_that_cannot_be_there_is_refused(complaint, command: str, place: str, says: str):
    assert says in complaint(f"{command} {place}")


def test_a_run_with_a_page_that_cannot_be_there_is_not_begun(complaint):
    said = complaint("run --driver processes --dashboard --http-port 65536 --out other")
    assert "--http-port 65536: must be 1 to 65535" in said


def test_a_recording_that_is_not_there_is_named_as_it_was_said(complaint):
    assert complaint("replay runs/nobody").startswith("concord: runs/nobody: there is none;")


def test_an_empty_recording_shows_no_page(complaint, home: Path):
    (home / "run" / RECORDING).write_bytes(b"")
    assert "run.mcap: nothing was recorded; the run ended" in complaint("replay run")


def test_a_folder_is_no_file_for_a_sweep(complaint):
    said = complaint("sweep --scenario oscillator --nodes 3 --steps 3 --runs 2 --out run")
    assert "run is a folder; name the file" in said


def test_a_setup_that_is_not_there_is_told_from_a_run(complaint):
    said = complaint("node nothing.json 0 --connect tcp/127.0.0.1:7447")
    assert "nothing.json: cannot be read" in said
    assert "`concord setup`" in said


@pytest.mark.skipif(not PROC.is_dir(), reason="needs a folder that takes no file from anybody")
@pytest.mark.parametrize("ending", ["graphml", "edges", "csv"])
def test_a_graph_file_that_a_folder_does_not_take_is_named(complaint, ending: str):
    out = f"{PROC}/ring.{ending}"
    said = complaint(f"topology generate ring --nodes 4 --out {out}")
    assert f"--out {out}: cannot be written (" in said
    assert "choose another place" in said


def test_a_graph_file_of_no_possible_name_is_named(complaint):
    out = f"{'y' * 300}.graphml"
    said = complaint(f"topology generate ring --nodes 4 --out {out}")
    assert f"--out {out}: cannot be written (File name too long)" in said


@pytest.mark.parametrize("source", ["nothing.csv", "nowhere/intel"])
def test_a_graph_file_that_is_not_there_is_no_misspelt_name(complaint, source: str):
    assert f"{source}: there is no such file or folder" in complaint(f"topology analyse {source}")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("flexray plan --nodes -1", "--nodes -1: must be at least 1"),
        ("run --stretch inf", "--stretch inf: must be at least 1, and finite"),
        (
            "run --rule labelled --relay --latch-delay-us inf",
            "--latch-delay-us inf: must be 0 or more, and finite",
        ),
        ("run --driver realtime --cycle-stretch inf", "--cycle-stretch inf: must be at least 1"),
    ],
)
def test_a_number_that_cannot_be_is_named_with_its_rule(complaint, arguments: str, says: str):
    assert says in complaint(arguments)


@pytest.mark.skipif(not PROC.is_dir(), reason="needs a folder that takes no file from anybody")
def test_a_design_that_cannot_be_kept_is_not_looked_for(complaint):
    fields = "--scenario oscillator --nodes 3 --steps 3 --graph ring,path --target-rmse 1"
    said = complaint(f"design {fields} --runs 2 --out {PROC}/design.json")
    assert f"--out {PROC}/design.json: cannot be written (" in said


@pytest.mark.parametrize("command", ["run --scenario vehicle-network", "identify"])
def test_a_drive_whose_car_is_none_is_named(complaint, home: Path, command: str):
    (home / "drive").mkdir()
    (home / "drive" / "car.toml").write_text("mass_kg = 'heavy'")
    said = complaint(f"{command} --data drive")
    assert said.startswith("concord: drive/car.toml: the car file is not valid: ")


@pytest.mark.parametrize(
    ("option", "of"),
    [
        ("--car bmw-320i", "--scenario vehicle-network"),
        ("--manoeuvre serpentine", "--scenario vehicle-network"),
        ("--static-slots 3", "--scenario meng2025-network or --schedule flexray"),
        ("--target 4", "--scenario mrclam"),
        ("--noise matched", "--scenario cruise-control"),
        ("--control 0", "--scenario cruise-control"),
    ],
)
@pytest.mark.parametrize("command", ["run", "agree", "sweep --runs 2 --out s.nc", "flexray plan"])
def test_an_option_of_another_scenario_is_not_ignored(
    complaint, command: str, option: str, of: str
):
    said = complaint(f"{command} --scenario oscillator --nodes 3 --steps 3 {option}")
    assert f"{option}: belongs to {of}" in said
