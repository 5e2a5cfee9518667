"""No reader of results runs code of a folder that it received, or opens a file that it names."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import xarray

from concord.experiments.cli import command_line
from concord.experiments.python_api import figures
from concord.results.records.netcdf_file import write_dataset
from concord.scenarios.scenario import Scenario
from concord.scenarios.user import trust as trusting

READERS = {
    "plot": ["plot", "{run}"],
    "plot of run.nc": ["plot", "{run}/run.nc"],
    "report": ["report", "{run}"],
    "collect": ["collect", "{run}"],
    "replay": ["replay", "{run}", "--http-port", "0"],
    "audit": ["audit", "{run}"],
    "node": ["node", "{run}/run.json", "0", "--connect", "tcp/127.0.0.1:1"],
    "environment": ["environment", "{run}/run.json", "--connect", "tcp/127.0.0.1:1"],
    "plot of a sweep": ["plot", "{run}/../sweep.nc"],
    "merge": ["merge", "{run}/../pieces", "--out", "{run}/../merged.nc"],
}


@pytest.fixture
def marker(tmp_path: Path) -> Path:
    return tmp_path / "the attacker was here"


@pytest.fixture
def attacked(tmp_path: Path, marker: Path, run_folder: Path) -> Path:
    """A run folder whose rule is the attacker's file, a sweep and pieces that name it too."""
    folder = tmp_path / "run"
    shutil.copytree(run_folder, folder)
    text = f"open({str(marker)!r}, 'w').close()\ndef r(beliefs, weights):\n    return beliefs\n"
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    (folder / f"innocent-{digest}.py").write_text(text)
    rule = {"type": "FILE.py:NAME", "source": "any/innocent.py:r", "digest": digest}
    with_scenario(folder, lambda scenario: scenario.update(rule=rule))
    name = f"{folder}/innocent-{digest}.py:r"
    specification = {"base": {"scenario": "oscillator", "rule": name}, "levels": {}}
    specification["digests"] = {name: digest}
    write_dataset(
        xarray.Dataset({"rmse": 0.0}, attrs={"specification": json.dumps(specification)}),
        tmp_path / "sweep.nc",
    )
    (tmp_path / "pieces").mkdir()
    begun = {"specification": specification, "versions": {}, "commit": None}
    (tmp_path / "pieces" / "sweep.json").write_text(json.dumps(begun))
    return folder


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    command("run", "--scenario", "oscillator", "--steps", "8", "--nodes", "4", "--out", str(folder))
    return folder


def command(*words: str) -> int:
    try:
        command_line.main(words)
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def with_scenario(folder: Path, change: Callable[[dict], None]) -> None:
    """Change the scenario in run.json and run.nc."""
    described = json.loads((folder / "run.json").read_text())
    change(described["setup"]["scenario"])
    (folder / "run.json").write_text(json.dumps(described))
    with xarray.open_dataset(folder / "run.nc", engine="h5netcdf") as opened:
        data = opened.load()
    scenario = json.loads(data.attrs["scenario"])
    change(scenario)
    write_dataset(data.assign_attrs(scenario=json.dumps(scenario)), folder / "run.nc")


@pytest.mark.parametrize("reader", READERS)
def test_no_reader_runs_code_of_a_folder(
    reader: str, attacked: Path, marker: Path, capsys: pytest.CaptureFixture[str]
):
    words = [word.format(run=attacked) for word in READERS[reader]]
    assert command(*words) == 2
    said = capsys.readouterr().err
    assert "names the code of" in said and "innocent" in said and "--trust" in said
    assert "Traceback" not in said
    assert not marker.exists()


def test_a_data_set_runs_no_code(attacked: Path, marker: Path):
    with (
        xarray.open_dataset(attacked / "run.nc", engine="h5netcdf") as data,
        pytest.raises(ValueError, match="names the code of"),
    ):
        figures(data)
    assert not marker.exists()


def test_a_trusted_folder_may_run_its_code(
    attacked: Path, marker: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(trusting, "_trusted", [])
    assert command("plot", str(attacked), "--trust", str(attacked)) == 0
    assert marker.exists()
    assert command("plot", str(attacked), "--trust", str(attacked / "none")) == 2


OWN_PLANT = """
import pathlib
import numpy as np
import concord as cc
pathlib.Path({marker!r}).touch()
def move(x):
    return x @ np.array([[1, -0.1], [0.1, 0.9]])
plant = cc.OwnPlant(
    f=move, Q=[1e-3, 1e-3], mean=[1, 0], cov=[1, 1], time_step_s=0.1,
    state_names=("swing", "swing rate"), state_units=("rad", "rad/s"),
)
OWN = cc.own_scenario(plant, [cc.OwnSensor(h=lambda x: x[..., :1], R=0.1), None], nodes=4)
"""


def test_an_own_plant_of_another_user_has_the_owners_words_where_it_is_trusted(
    tmp_path: Path, marker: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(trusting, "_trusted", [])
    own, folder, received = (tmp_path / name for name in ("own.py", "run", "received"))
    own.write_text(OWN_PLANT.format(marker=str(marker)))
    asked = ("--scenario", f"{own}:OWN", "--steps", "12", "--driver", "in-process")
    assert command("run", *asked, "--out", str(folder)) in (0, 1)
    assert command("report", str(folder), "--out", str(tmp_path / "owner.md")) == 0
    shutil.copytree(folder, received)
    own.unlink()
    (tmp_path / "state" / "concord" / "own_files").unlink()
    monkeypatch.setattr(trusting, "_known", set())
    marker.unlink()
    for reader in ("plot", "report", "collect", "replay", "audit"):
        assert command(reader, str(received)) == 2
        assert "names the code of" in capsys.readouterr().err
    assert not marker.exists()
    words = ("--out", str(tmp_path / "other.md"), "--trust", str(received))
    assert command("report", str(received), *words) == 0
    # All but the pictures and the settings, which name the owner's file.
    owner, other = (
        [line for line in (tmp_path / name).read_text().splitlines() if line[:1] not in ("!", " ")]
        for name in ("owner.md", "other.md")
    )
    assert any("rad" in line for line in owner)
    assert [one for one in zip(owner, other, strict=True) if one[0] != one[1]] == []


def test_code_of_own_runs_is_known_to_later_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    own = tmp_path / "own.py"
    own.write_text("from tests.scenarios.test_user_values import rule as r\n")
    folder = tmp_path / "run"
    asked = ("--scenario", "oscillator", "--steps", "8", "--nodes", "4", "--rule", f"{own}:r")
    assert command("run", *asked, "--out", str(folder)) == 0
    monkeypatch.setattr(trusting, "_known", set())
    own.unlink()
    assert command("plot", str(folder)) == 0
    (tmp_path / "state" / "concord" / "own_files").unlink()
    assert command("plot", str(folder)) == 2
    assert "names the code of" in capsys.readouterr().err


@pytest.mark.parametrize(
    "change",
    [
        lambda one: one["network"].update(graph="file:/etc/passwd"),
        lambda one: one["network"].update(graph="os.path:join"),
        lambda one: one.update(changes=["3 set graph=/root/own.py:G"]),
        lambda one: one.update(changes=["file:/etc/shadow"]),
        lambda one: one.update(plant={"type": "FILE.py:NAME", "source": "/a.py:b", "digest": ""}),
        lambda one: one["bus"].update(schedule={"type": "dynamic", "arbiter": "/a.py:b"}),
    ],
)
@pytest.mark.parametrize("reader", ["plot", "collect", "audit"])
def test_no_reader_opens_a_file_of_the_machine(
    reader: str, change: Callable[[dict], None], run_folder: Path, tmp_path: Path, capsys
):
    folder = tmp_path / "run"
    shutil.copytree(run_folder, folder)
    with_scenario(folder, change)
    assert command(reader, str(folder)) == 2
    assert "which no run of yours has named" in capsys.readouterr().err


def test_a_scenario_without_files_names_none():
    text = '{"plant": {"type": "oscillator"}, "network": {"nodes": 3, "graph": "ring"}, "steps": 9}'
    scenario = msgspec.json.decode(text, type=Scenario)
    trusting.require_known(scenario, Path("run"))
