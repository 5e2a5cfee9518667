"""`concord doctor`: each check on a machine that is well, poor or broken."""

import errno
import resource
import tempfile
from pathlib import Path

import msgspec
import pytest

from concord.experiments.cli import doctor
from concord.experiments.cli.doctor import Looked, Verdict
from concord.runtime.network.zenoh_transport import LinkError
from concord.studies.memory import available_memory_mb
from tests.experiments.command_support import concord, refused

OK, WARNING, FAILING = Verdict.OK, Verdict.WARNING, Verdict.FAILING


@pytest.mark.parametrize(
    ("nodes", "free_mb", "verdict"),
    [
        (16, 8000, OK),
        (16, 1000, WARNING),
        (16, 500, FAILING),
        (4000, 8000, FAILING),
        (4, None, WARNING),
    ],
)
def test_memory_is_weighed_against_the_nodes(nodes: int, free_mb: float | None, verdict: Verdict):
    assert doctor.memory(nodes, free_mb).verdict is verdict


def test_the_nodes_that_are_said_to_fit_do_fit():
    seen = doctor.memory(1000, 2000)
    fit = int(seen.cure.split("at most ")[1].split()[0])
    assert doctor.memory(fit, 2000).verdict is not FAILING
    assert doctor.memory(fit + 1, 2000).verdict is FAILING


def test_a_container_s_limit_counts(tmp_path: Path):
    (tmp_path / "meminfo").write_text("MemTotal: 9000000 kB\nMemAvailable: 4194304 kB\n")
    assert available_memory_mb(tmp_path, tmp_path) == 4096
    (tmp_path / "memory.current").write_text(str(200 << 20))
    (tmp_path / "memory.max").write_text("max\n")
    assert available_memory_mb(tmp_path, tmp_path) == 4096
    (tmp_path / "memory.max").write_text(str(1000 << 20))
    assert available_memory_mb(tmp_path, tmp_path) == 800
    assert available_memory_mb(tmp_path / "none", tmp_path) is None


@pytest.mark.parametrize(
    ("limit", "verdict"), [(1024, OK), (43, FAILING), (resource.RLIM_INFINITY, OK)]
)
def test_the_limit_of_open_files(limit: int, verdict: Verdict):
    assert doctor.files(16, limit).verdict is verdict


def test_no_folder_for_sockets_is_a_failure(monkeypatch: pytest.MonkeyPatch):
    def none(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "none left")

    assert doctor.sockets().verdict is OK
    monkeypatch.setattr(tempfile, "TemporaryDirectory", none)
    found = doctor.sockets()
    assert found.verdict is FAILING
    assert found.cure


def test_many_threads_of_linear_algebra_are_named():
    many = doctor.blas({"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "8"}, 2)
    assert many.verdict is WARNING and "unset OMP_NUM_THREADS:" in many.cure
    assert doctor.blas({"OPENBLAS_NUM_THREADS": "1"}, None).verdict is OK


def test_late_and_wrong_clocks():
    assert doctor.clock([1e-4, 2e-4, 0.5], 2026).verdict is OK
    assert doctor.clock([0.01, 0.02, 0.01], 2026).verdict is WARNING
    assert doctor.clock([1e-4], 1970).verdict is FAILING
    assert len(doctor.measured_lateness_s(3)) == 3


def test_a_folder_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert doctor.disk(tmp_path).verdict is not FAILING
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    assert doctor.disk(tmp_path).verdict is FAILING


def test_a_silent_or_shut_zenoh_is_a_failure():
    def silent():
        raise TimeoutError("nothing comes back")

    def shut():
        raise LinkError("cannot join")

    assert doctor.zenoh(lambda: 1e-4).verdict is OK
    assert doctor.zenoh(silent).verdict is FAILING
    assert "cannot join" in doctor.zenoh(shut).seen


def test_browsers():
    assert doctor.browser(lambda name: None).verdict is WARNING
    assert doctor.browser({"chromium": "/opt/chromium"}.get).seen == "/opt/chromium"


def test_extras_say_how_to_get_them(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: None)
    assert doctor.extra("secure").verdict is Verdict.OPTIONAL
    assert "pip install '.[secure]'" in doctor.extra("secure").cure
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: object())
    assert doctor.extra("secure").verdict is OK


def test_the_extras_are_those_of_the_package():
    import tomllib

    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert set(doctor.EXTRAS) == set(project["project"]["optional-dependencies"])


@pytest.mark.parametrize(("verdict", "code"), [(OK, 0), (WARNING, 0), (FAILING, 1)])
@pytest.mark.parametrize("as_json", [True, False])
def test_the_exit_code_tells(
    verdict: Verdict,
    code: int,
    as_json: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    found = [
        Looked("this", OK, "fine"),
        Looked("that", verdict, "[seen]", "do something"),
    ]
    monkeypatch.setattr(doctor, "look", lambda nodes: iter(found))
    told = concord(capsys, "doctor", *(["--json"] if as_json else []))
    assert told.code == code
    if as_json:
        said = told.json()
        assert said["healthy"] is (code == 0)
        assert [one["verdict"] for one in said["findings"]] == ["ok", verdict.value]
    else:
        assert "that: [seen]" in told.out and "-> do something" in told.out


def test_no_nodes_is_a_mistake(capsys: pytest.CaptureFixture[str]):
    assert "at least one node" in refused(concord(capsys, "doctor", "--nodes", 0))


@pytest.mark.zenoh
def test_this_machine_in_a_fresh_process(tmp_path: Path):
    import subprocess
    import sys

    done = subprocess.run(
        [sys.executable, "-m", "concord.experiments", "doctor", "--nodes", "2", "--json"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        timeout=600,
    )
    said = msgspec.json.decode(done.stdout)
    assert said["healthy"] is (done.returncode == 0)
    seen = {one["subject"]: one for one in said["findings"]}
    assert seen["zenoh"]["verdict"] == "ok", seen["zenoh"]
    assert {"sockets", "memory", "threads", "clock", "disk", "browser"} <= set(seen)
