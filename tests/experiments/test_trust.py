"""No reader of results runs code of a folder that it received, or opens a file that it names."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import xarray

from concord.dashboard.frames.source import RecordedSource
from concord.dashboard.frames.stage import set_stage
from concord.experiments.cli import command_line
from concord.experiments.other_runs import OtherRuns
from concord.experiments.python_api import figures
from concord.results.folder import read_shown
from concord.results.records.netcdf_file import write_dataset
from concord.results.run_plots import run_figures
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


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory, run_folder: Path) -> Path:
    """A run folder whose rule is the attacker's file, a sweep and pieces that name it too.

    The code that is run leaves the file `was_here`.
    """
    tmp_path = tmp_path_factory.mktemp("attacked")
    folder, marker = tmp_path / "run", was_here(tmp_path / "run")
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


def was_here(attacked: Path) -> Path:
    return attacked.with_name("the attacker was here")


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
    reader: str, attacked: Path, capsys: pytest.CaptureFixture[str]
):
    words = [word.format(run=attacked) for word in READERS[reader]]
    assert command(*words) == 2
    said = capsys.readouterr().err
    assert "names the code of" in said and "innocent" in said and "--trust" in said
    assert "Traceback" not in said
    assert not was_here(attacked).exists()


def test_a_data_set_runs_no_code(attacked: Path):
    with (
        xarray.open_dataset(attacked / "run.nc", engine="h5netcdf") as data,
        pytest.raises(ValueError, match="names the code of"),
    ):
        figures(data)
    assert not was_here(attacked).exists()


@pytest.mark.usefixtures("blank_pictures")
def test_a_trusted_folder_may_run_its_code(attacked: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(trusting, "_trusted", [])
    assert command("plot", str(attacked), "--trust", str(attacked)) == 0
    was_here(attacked).unlink()
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


@pytest.fixture(scope="module")
def owned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of an own plant and the report of its owner, whose file is gone.

    The code that is run leaves the file `was_here`.
    """
    place = tmp_path_factory.mktemp("owned")
    own, folder = place / "own.py", place / "run"
    own.write_text(OWN_PLANT.format(marker=str(was_here(folder))))
    asked = ("--scenario", f"{own}:OWN", "--steps", "12", "--driver", "in-process")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(place / "state"))
        patch.setattr(trusting, "_trusted", [])
        patch.setattr(trusting, "_known", set())
        assert command("run", *asked, "--out", str(folder)) in (0, 1)
        assert command("report", str(folder), "--out", str(place / "owner.md")) == 0
    own.unlink()
    was_here(folder).unlink()
    return place


@pytest.fixture
def received(owned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of this run, with a user who has run nothing of it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(trusting, "_trusted", [])
    monkeypatch.setattr(trusting, "_known", set())
    return shutil.copytree(owned / "run", tmp_path / "received")


@pytest.mark.usefixtures("blank_pictures")
def test_an_own_plant_of_another_user_has_the_owners_words_where_it_is_trusted(
    owned: Path, received: Path, capsys: pytest.CaptureFixture[str]
):
    marker, page = was_here(owned / "run"), received / "other.md"
    assert command("audit", str(received)) == 2
    assert "names the code of" in capsys.readouterr().err
    assert not marker.exists()
    words = ("--out", str(page), "--trust", str(received))
    assert command("report", str(received), *words) == 0
    marker.unlink()
    # All but the pictures and the settings, which name the owner's file.
    owner, other = (
        [line for line in file.read_text().splitlines() if line[:1] not in ("!", " ")]
        for file in (owned / "owner.md", page)
    )
    assert any("rad" in line for line in owner)
    assert [one for one in zip(owner, other, strict=True) if one[0] != one[1]] == []


@pytest.fixture
def foreign(received: Path) -> Path:
    """A received run of an own plant, which names its copy in the folder as the file to run."""
    copy = next(received.glob("own-*.py"))
    with_scenario(received, lambda one: one["plant"].update(source=f"{copy}:OWN"))
    return received


def named_by_plot(folder: Path) -> tuple[str, ...]:
    label = run_figures(folder)["error-over-time"].axes[0].get_ylabel()
    return (label.removeprefix("error [").removesuffix("]"),)


def named_by_report(folder: Path) -> tuple[str, ...]:
    page = folder / "page.md"
    assert command("report", str(folder), "--out", str(page)) == 0
    line = next(line for line in page.read_text().splitlines() if line.startswith("States: "))
    return tuple(line.removeprefix("States: ").removesuffix(".").split(", "))


def named_by_collect(folder: Path) -> tuple[str, ...]:
    (folder / "run.nc").unlink()
    assert command("collect", str(folder)) in (0, 1)
    with xarray.open_dataset(folder / "run.nc", engine="h5netcdf") as data:
        pairs = zip(data["state"].to_numpy(), data["state_unit"].to_numpy(), strict=True)
        return tuple(f"{name} [{unit}]" for name, unit in pairs)


def named_by_replay(folder: Path) -> tuple[str, ...]:
    setup = read_shown(folder).setup
    OtherRuns(setup, sparing=False).close()
    stage = set_stage(setup)
    assert len(RecordedSource(stage, folder / "run.mcap").poll()) > 0
    pairs = zip(stage.state_names, stage.state_units, strict=True)
    return tuple(f"{name} [{unit}]" for name, unit in pairs)


BOTH = ("swing [rad]", "swing rate [rad/s]")


@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize(
    ("named", "expected"),
    [
        (named_by_plot, ("rad",)),
        (named_by_report, BOTH),
        (named_by_collect, BOTH),
        (named_by_replay, BOTH),
    ],
)
def test_a_reader_names_the_states_of_an_own_plant_without_its_code(
    named: Callable[[Path], tuple[str, ...]],
    expected: tuple[str, ...],
    foreign: Path,
    owned: Path,
):
    verdict = json.loads((foreign / "run.json").read_text())["verdict"]
    assert named(foreign) == expected
    assert not was_here(owned / "run").exists()
    assert json.loads((foreign / "run.json").read_text())["verdict"] == verdict


def test_past_states_of_a_received_run_ask_for_its_code(
    foreign: Path, owned: Path, capsys: pytest.CaptureFixture[str]
):
    assert command("collect", str(foreign), "--smooth") == 2
    assert f"add --trust {foreign}" in capsys.readouterr().err
    assert not was_here(owned / "run").exists()


@pytest.mark.usefixtures("blank_pictures")
def test_code_of_own_runs_is_known_to_later_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(trusting, "_known", set())
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
    ("reader", "change"),
    [
        ("collect", lambda one: one["network"].update(graph="file:/etc/passwd")),
        ("plot", lambda one: one["network"].update(graph="file:/etc/passwd")),
        ("audit", lambda one: one["network"].update(graph="os.path:join")),
        ("collect", lambda one: one.update(changes=["3 set graph=/root/own.py:G"])),
        ("collect", lambda one: one.update(changes=["file:/etc/shadow"])),
        (
            "collect",
            lambda one: one["bus"].update(schedule={"type": "dynamic", "arbiter": "/a.py:b"}),
        ),
    ],
)
def test_no_reader_opens_a_file_of_the_machine(
    reader: str, change: Callable[[dict], None], run_folder: Path, tmp_path: Path, capsys
):
    folder = tmp_path / "run"
    shutil.copytree(run_folder, folder)
    with_scenario(folder, change)
    assert command(reader, str(folder)) == 2
    assert "which no run of yours has named" in capsys.readouterr().err


@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize(("reader", "code"), [("plot", 0), ("collect", 0), ("audit", 2)])
def test_the_file_of_a_plant_is_not_opened_and_an_audit_asks_for_it(
    reader: str, code: int, run_folder: Path, tmp_path: Path, marker: Path
):
    folder, file = tmp_path / "run", tmp_path / "a.py"
    shutil.copytree(run_folder, folder)
    file.write_text(f"open({str(marker)!r}, 'w').close()\n")
    plant = {"type": "FILE.py:NAME", "source": f"{file}:b", "digest": ""}
    with_scenario(folder, lambda one: one.update(plant=plant))
    assert command(reader, str(folder)) == code
    assert not marker.exists()


def test_a_scenario_without_files_names_none():
    text = '{"plant": {"type": "oscillator"}, "network": {"nodes": 3, "graph": "ring"}, "steps": 9}'
    scenario = msgspec.json.decode(text, type=Scenario)
    trusting.require_known(scenario, Path("run"))
