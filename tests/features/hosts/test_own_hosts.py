"""Two hosts with addresses and folders of their own run a user's plant, rule and bus from files."""

from pathlib import Path

import pytest

from concord.results.folder import read_description
from concord.runtime.drivers import in_this_process
from concord.scenarios.user.values import source_of
from concord.studies.agree import first_difference
from tests.experiments.support import trace_of
from tests.features.hosts.hosts import hosts
from tests.namespaces import lan
from tests.pages import ROOT, blocks
from tests.processes import CONCORD, PROC, family

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.slow,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]
PAGE = (ROOT / "docs" / "own_plant.md").read_text(encoding="utf-8")
FILES = {
    name: next(code for code in blocks(PAGE, "python") if mark in code)
    for name, mark in (("pendulum", "PENDULUM"), ("sharpest", "slogdet"), ("serial", "BIT_US"))
}
OWN = (
    *("--scenario", "./pendulum.py:SCENARIO", "--rule", "./sharpest.py:sharpest"),
    *("--bus", "./serial.py:Serial"),
)


def write_files(folder: Path, **changed: str) -> Path:
    folder.mkdir()
    for name, text in {**FILES, **changed}.items():
        (folder / f"{name}.py").write_text(text)
    return folder


@pytest.mark.parametrize("changed", ["pendulum", "sharpest", "serial"])
def test_a_host_with_another_file_is_refused_and_one_with_the_same_completes_the_run(
    tmp_path: Path, changed: str, monkeypatch: pytest.MonkeyPatch
):
    """The setup travels as a file; each host reads plant, rule and bus from its own folder."""
    a = write_files(tmp_path / "a")
    other = {changed: FILES[changed] + "\n# Another line.\n"}
    wrong, right = write_files(tmp_path / "wrong", **other), write_files(tmp_path / "right")
    setup = tmp_path / "setup.json"
    asked = ("setup", *OWN, "--steps", "40", "--out", str(setup), "--name", "hosts")
    with family((*CONCORD, *asked), a) as command:
        code, _, err = command.end(60)
        assert code == 0, err
    with lan("ab") as there, hosts(a) as at_a, hosts(wrong) as at_wrong, hosts(right) as at_right:
        ends = {host: there.endpoint(host) for host in "ab"}
        at_a.router(ends["a"], prefix=there.at("a"))
        at_right.router(ends["b"], ends["a"], prefix=there.at("b"))
        environment = at_a.concord(
            "environment", setup, "--connect", ends["a"], "--out", tmp_path / "run", "--json",
            prefix=there.at("a"),
        )  # fmt: skip
        at_a.concord("node", setup, 0, 1, 2, "--connect", ends["a"], prefix=there.at("a"))
        joining = ("node", setup, 3, 4, 5, "--connect", ends["b"])
        code, _, refusal = at_wrong.concord(*joining, prefix=there.at("b")).end(60)
        assert code == 2, refusal
        for file in (wrong, right):
            assert source_of(f"{file}/{changed}.py:X").digest in refusal
        assert f"{wrong}/{changed}.py" in refusal and "copy that file" in refusal
        at_right.concord(*joining, prefix=there.at("b"))
        code, _, err = environment.end(120)
        assert code == 0, err
    description = read_description(tmp_path / "run")
    monkeypatch.chdir(a)
    in_this_process(description.setup, "one", tmp_path / "one.mcap", None, lambda step: None)
    one = trace_of(description.setup, tmp_path / "one.mcap")
    several = trace_of(description.setup, tmp_path / "run" / "run.mcap")
    assert several.steps == 40
    assert first_difference(one, several, "hosts") is None
