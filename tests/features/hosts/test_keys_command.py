"""`concord keys`: which files it makes, and what --check says of them."""

from pathlib import Path

import pytest

from tests.experiments.command_support import concord, refused

pytest.importorskip("cryptography")


def test_the_files_are_listed_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    made = concord(capsys, "keys", tmp_path / "keys", "--nodes", 1, "--json").json()
    assert set(made["files"]) == {file.name for file in (tmp_path / "keys").iterdir()}


def test_the_files_of_a_folder_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    keys = tmp_path / "keys"
    code, out, _ = concord(capsys, "keys", keys, "--nodes", 1, "--check")
    assert code == 0 and "\nnode-0.json: ok\n" in out
    (keys / "node-0.json").chmod(0o604)
    told = concord(capsys, "keys", keys, "--check", "--json")
    assert told.code == 1 and not told.json()["sound"]
    assert "chmod 600" in told.json()["files"]["node-0.json"]
    assert "no keys there" in refused(concord(capsys, "keys", tmp_path, "--check"))
