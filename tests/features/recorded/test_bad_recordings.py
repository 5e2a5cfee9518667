"""Test what a damaged recording, or one that does not hold what is asked for, is refused with."""

from pathlib import Path

import pytest

from tests.experiments.command_support import concord, refused


@pytest.fixture
def complaint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Return the message of a refused run; check that it leaves no file behind."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CONCORD_MRCLAM", raising=False)

    def said(arguments: str) -> str:
        before = sorted(tmp_path.rglob("*"))
        message = refused(concord(capsys, "run", *arguments.split()))
        assert sorted(tmp_path.rglob("*")) == before
        return message

    return said


def test_recorded_data_must_be_named(complaint):
    message = complaint("--scenario mrclam --target 4")
    assert "--data" in message
    assert "CONCORD_MRCLAM" in message


@pytest.fixture
def damaged(mrclam_folder: Path, tmp_path: Path):
    """A copy of the recording in which one file is changed, or gone."""

    def copy(file: str, change) -> str:
        folder = tmp_path / "data"
        folder.mkdir()
        for original in mrclam_folder.iterdir():
            if original.name != file:
                (folder / original.name).symlink_to(original)
        content = change((mrclam_folder / file).read_bytes())
        if content is not None:
            (folder / file).write_bytes(content)
        return "--scenario mrclam --data data --target 4"

    return copy


@pytest.mark.parametrize(
    "file", ["Barcodes.dat", "Robot3_Measurement.dat", "Robot5_Groundtruth.dat"]
)
def test_a_truncated_file_is_named_with_its_line(complaint, damaged, file: str):
    arguments = damaged(file, lambda content: content[: content.rstrip().rfind(b"\n") + 4])
    message = complaint(arguments)
    assert f"data/{file}:" in message
    assert "cut off?" in message


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("--target 9", "no robot 9"),
        ("--target 4 --nodes 7", "--nodes 7"),
        ("--target 4 --steps 99999", "--steps 99999"),
    ],
)
def test_what_a_recording_does_not_hold_cannot_be_asked_for(
    complaint, mrclam_folder: Path, option: str, says: str
):
    assert says in complaint(f"--scenario mrclam --data {mrclam_folder} {option}")
