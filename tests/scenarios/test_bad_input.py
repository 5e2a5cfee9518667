"""Test user errors: one helpful sentence, exit code 2, and no files left behind."""

import socket
from pathlib import Path

import pytest

from concord.experiments.__main__ import main
from tests.experiments.command_support import concord, refused

UNKNOWN_NAMES = [
    ("--scenario target-traking", "scenario 'target-traking'", "'target-tracking'"),
    ("--graph rnig", "graph 'rnig'", "'ring'"),
    ("--weights metropolys", "weights 'metropolys'", "'metropolis'"),
    ("--bus flexrey", "bus 'flexrey'", "'flexray'"),
    ("--rule wacc", "rule 'wacc'", "'wac'"),
    ("--schedule round-robbin", "schedule 'round-robbin'", "'round-robin'"),
    ("--hold decade", "hold 'decade'", "'decayed'"),
    ("--number float46", "number 'float46'", "'float64'"),
    ("--schedule hybrid --arbiter wtdo", "arbiter 'wtdo'", "'wtod'"),
    ("--cluster fited", "cluster 'fited'", "'fitted'"),
]
NUMBERS = [
    ("--nodes 0", "at least 1"),
    ("--steps -1", "at least 1"),
    ("--seed -1", "0 or more"),
    ("--occupancy 0", "(0, 1]"),
    ("--occupancy nan", "(0, 1]"),
    ("--decay 1.1", "[0, 1]"),
    ("--schedule dynamic --trigger nan", "0 or more"),
    ("--stretch 0.5", "at least 1"),
    ("--loss 1", "at least 0 and below 1"),
]
GRAPH_FILES = {
    "two.edges": "0 1\n2 3\n",
    "three.edges": "0 1\n1 2\n",
    "columns.edges": "0 1\n1 2 3 4\n",
    "one_way.csv": "0,1,0,0\n0,0,1,0\n0,1,0,1\n0,0,1,0\n",
    "graph.dot": "graph {}\n",
}
GRAPHS = [
    ("two.edges", "2 pieces that cannot hear each other"),
    ("three.edges", "3 nodes, but 4 were asked for"),
    ("columns.edges", "columns.edges:2: 4 columns"),
    ("one_way.csv", "both ways"),
    ("graph.dot", "export or convert it to one of"),
    ("missing.edges", "no such file"),
]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to run in."""
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def complaint(home: Path, capsys: pytest.CaptureFixture[str]):
    """Return the message of a refused command; check its exit and the files left behind."""

    def said(arguments: str, keeps: tuple[str, ...] = (), command: str = "run") -> str:
        message = refused(concord(capsys, command, *arguments.split()))
        assert sorted(entry.name for entry in home.iterdir()) == sorted(keeps)
        return message

    return said


@pytest.mark.parametrize("command", ["run", "agree"])
@pytest.mark.parametrize(("option", "named", "nearest"), UNKNOWN_NAMES)
def test_an_unknown_name_is_answered_with_the_nearest(
    complaint, option: str, named: str, nearest: str, command: str
):
    base = "" if "--scenario" in option else "--scenario oscillator --nodes 4 --steps 5 "
    message = complaint(base + option, command=command)
    assert f"unknown {named}" in message
    assert f"did you mean {nearest}?" in message
    assert "Valid names are" in message


@pytest.mark.parametrize(("option", "rule"), NUMBERS)
def test_an_impossible_number_is_named_with_its_rule(complaint, option: str, rule: str):
    message = complaint(f"--scenario oscillator {option}")
    name, value = option.split()[-2:]
    assert f"{name} {value}" in message
    assert rule in message


@pytest.mark.parametrize(("file", "says"), GRAPHS)
def test_a_graph_that_cannot_be_used_is_refused(complaint, home: Path, file: str, says: str):
    if file in GRAPH_FILES:
        (home / file).write_text(GRAPH_FILES[file])
    keeps = (file,) if file in GRAPH_FILES else ()
    message = complaint(f"--scenario oscillator --nodes 4 --graph file:{file}", keeps)
    assert says in message


def test_weights_that_would_subtract_a_covariance_are_refused(complaint):
    message = complaint("--scenario oscillator --nodes 8 --graph star --weights best-constant")
    assert "none may be below 0" in message
    assert "use metropolis" in message


def test_a_number_that_is_none_is_refused_by_the_command_line(
    home: Path, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as left:
        main(["run", "--nodes", "many"])
    assert left.value.code == 2
    assert "--nodes" in capsys.readouterr().err
    assert list(home.iterdir()) == []


# --- where results go ----------------------------------------------------------------------------


def test_a_folder_that_exists_is_never_written_over(complaint, home: Path):
    (home / "run").mkdir()
    (home / "run" / "mine.txt").write_text("mine")
    message = complaint("--scenario oscillator --out run", keeps=("run",))
    assert "--out run: the folder exists" in message
    assert "choose another name" in message
    assert (home / "run" / "mine.txt").read_text() == "mine"
    assert len(list((home / "run").iterdir())) == 1


def test_a_folder_below_a_file_cannot_be_made(complaint, home: Path):
    (home / "file").write_text("")
    message = complaint("--scenario oscillator --out file/run", keeps=("file",))
    assert "--out file/run: cannot be made" in message


# --- ports ---------------------------------------------------------------------------------------

PROCESSES = "--scenario oscillator --nodes 3 --graph path --steps 3 --driver processes --out run"


@pytest.mark.zenoh
def test_a_port_in_use_is_named_and_leaves_nothing(complaint):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        message = complaint(f"{PROCESSES} --port {port}")
    assert f"port {port} is in use" in message
    assert "leave --port out" in message


@pytest.mark.zenoh
@pytest.mark.parametrize("port", [1, 80, 65534, -5])
def test_a_port_out_of_range_is_refused(complaint, port: int):
    message = complaint(f"{PROCESSES} --port {port}")
    assert f"--port {port}" in message
    assert "1024..65535" in message
