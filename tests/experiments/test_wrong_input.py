"""Test user errors: one line with name and cure, exit code 2, and no unfinished files."""

import shlex
import shutil
from pathlib import Path

import pytest

from concord.experiments.__main__ import main
from concord.results.records.netcdf_file import RECORDING
from tests.experiments.command_support import concord, refused
from tests.features.rows import rows_of_features
from tests.processes import PROC

# By command, options and what is said of them.
REFUSED = {
    "sweep -o s.nc": [
        ("--graph ring,rnig", "cell graph=rnig (2 of 2)"),
        ("--rule ci --occupancy 0,1", "(0, 1]"),
        ("--latin-hypercube 5", "nothing is swept"),
        ("--shard 0/3", "must be NUMBER/SHARDS"),
        ("--shard 4/3", "must be NUMBER/SHARDS"),
        ("--shard 1/3 --pieces kept", "leave --pieces out"),
        ("--keep moments --interval bootstrap", "use --interval t or --keep figures"),
    ],
    "compare -o out": [
        ("--rule covariance", "must be FILE.py:NAME"),
        ("--rule ci", "every built-in rule takes part anyway"),
        ("--rule ./none.py:RULE", "there is no file ./none.py"),
        ("--case geometrc", "did you mean 'geometric'?"),
        ("--runs 0", "--runs 0: must be at least 1"),
        ("--workers 0", "must be at least 1"),
        ("--data nowhere", "nowhere"),
        ("--case path --data nowhere", "--data nowhere: none of the cases is recorded"),
    ],
    "design -o d.json": [
        ("--target-rmse much", "positive number"),
        ("--target-rmse 2x-bound --runs 1", "at least 2"),
    ],
    "run": [
        ("--runs 3", "--runs 3 with --driver in-process"),
        ("--runs 0 --driver batched", "--runs 0: must be at least 1"),
        ("--covariances", "--covariances with --driver in-process"),
        ("--port 7000 --driver batched", "--port 7000 with --driver batched"),
        (
            "--driver processes --dashboard --http-port 65536",
            "--http-port 65536: must be 1 to 65535",
        ),
        ("--stretch inf", "--stretch inf: must be at least 1, and finite"),
        (
            "--rule labelled --relay --latch-delay-us inf",
            "--latch-delay-us inf: must be 0 or more, and finite",
        ),
        ("--driver realtime --cycle-stretch inf", "--cycle-stretch inf: must be at least 1"),
    ],
    "topology": [
        ("analyse rign", "unknown graph 'rign': did you mean 'ring'"),
        ("analyse", "which graph?"),
        ("analyse ring --links bernouli:0.1", "did you mean 'bernoulli:P'"),
        ("analyse ring --links measured", "no chances of delivery"),
        ("analyse ring --links moving:100", "add --scenario"),
        ("analyse ring --weights metropolys", "did you mean 'metropolis'"),
        ("compare ring rign", "unknown graph 'rign'"),
        ("compare ring --seeds 0", "--seeds 0: must be at least 1"),
        ("generate ring --out ring.dot", "name it to end in one of"),
        ("generate ring --out nowhere/ring.csv", "no such folder"),
        ("show ring --out ring.gif", "a picture ends in .png, .svg, .pdf"),
        ("show ring --out ring.png --layout places", "has none; use auto"),
        ("analyse nothing.csv", "nothing.csv: there is no such file or folder"),
        ("analyse nowhere/intel", "nowhere/intel: there is no such file or folder"),
    ],
}
TABLE = REFUSED | rows_of_features("REFUSED")


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
        message = refused(concord(capsys, *shlex.split(arguments)))
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


@pytest.mark.parametrize("command", ["replay", "audit", "plot", "report"])
def test_a_run_that_is_not_there_is_named_as_it_was_said(complaint, command: str):
    assert complaint(f"{command} runs/nobody").startswith("concord: runs/nobody does not exist; ")


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


@pytest.mark.parametrize(
    ("arguments", "says"),
    [(f"{command} {words}", says) for command, rows in TABLE.items() for words, says in rows],
)
def test_what_cannot_be_is_refused_in_one_line(complaint, arguments: str, says: str):
    assert says in complaint(arguments)


@pytest.mark.skipif(not PROC.is_dir(), reason="needs a folder that takes no file from anybody")
def test_a_design_that_cannot_be_kept_is_not_looked_for(complaint):
    fields = "--scenario oscillator --nodes 3 --steps 3 --graph ring,path --target-rmse 1"
    said = complaint(f"design {fields} --runs 2 --out {PROC}/design.json")
    assert f"--out {PROC}/design.json: cannot be written (" in said


@pytest.mark.parametrize(("option", "of"), rows_of_features("OPTIONS_OF_A_SCENARIO").items())
@pytest.mark.parametrize("command", ["run", "agree", "sweep --runs 2 --out s.nc"])
def test_an_option_of_another_scenario_is_not_ignored(
    complaint, command: str, option: str, of: str
):
    said = complaint(f"{command} --scenario oscillator --nodes 3 --steps 3 {option}")
    assert f"{option}: belongs to {of}" in said
