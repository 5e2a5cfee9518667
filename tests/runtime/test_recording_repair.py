"""Recordings whose recorder died at any byte are whole files for other readers again."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.runtime.recording import DAMAGE, McapRecorder, read_recording
from concord.runtime.recording_repair import finish_recording

MESSAGES = [("bid/0", b'{"n":%d}' % n) for n in range(20)] + [("truth", b'{"step":1}')]


def recorded(path: Path) -> bytes:
    """The bytes of a recording that was never closed."""
    recorder = McapRecorder(path, 1, 0.1, SHARE_FRAMES)
    recorder.record(MESSAGES)
    unfinished = path.read_bytes()
    recorder.close()
    return unfinished


def by_another_reader(path: Path) -> list[tuple[str, bytes]]:
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        found = [(channel.topic, message.data) for _, channel, message in reader.iter_messages()]
        assert summary.statistics.message_count == len(found)
    return found


@given(st.data())
def test_all_whole_messages_are_kept_wherever_the_recorder_died(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
):
    path = tmp_path_factory.mktemp("cut") / "run.mcap"
    whole = recorded(path)
    path.write_bytes(whole[: data.draw(st.integers(8, len(whole)))])
    before = list(read_recording(path))
    assert finish_recording(path)
    assert list(read_recording(path)) == before
    assert sorted(by_another_reader(path)) == sorted(before)
    assert not finish_recording(path)
    assert [file.name for file in path.parent.iterdir()] == ["run.mcap"]


def test_a_finished_recording_is_left_as_it_is(tmp_path: Path):
    path = tmp_path / "run.mcap"
    recorded(path)
    before = path.read_bytes()
    assert not finish_recording(path)
    assert path.read_bytes() == before and by_another_reader(path) == MESSAGES


@pytest.mark.parametrize("content", [b"no recording", b"x" * 10_000])
def test_a_file_that_is_no_recording_is_left_as_it_is(content: bytes, tmp_path: Path):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"run\.mcap: not a recording of concord"):
        finish_recording(path)
    assert path.read_bytes() == content
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]


def test_a_recorder_that_never_began_has_nothing_to_finish(tmp_path: Path):
    assert not finish_recording(tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())


@given(st.data())
def test_what_lies_behind_damage_is_kept(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
):
    """A flipped bit in a length, or zeros, in the middle of a finished or unfinished file."""
    path = tmp_path_factory.mktemp("hurt") / "run.mcap"
    unfinished = recorded(path)
    finished = data.draw(st.booleans())
    content = bytearray(path.read_bytes() if finished else unfinished)
    header = content.index(b'{"n":5}') - 31
    if data.draw(st.booleans()):
        content[header + 1 + data.draw(st.integers(0, 7))] ^= 1 << data.draw(st.integers(0, 7))
    else:
        content[header : header + 100] = bytes(100)
    path.write_bytes(content)
    kept = list(read_recording(path))
    assert [one for one in kept if one[0] == DAMAGE]
    assert set(MESSAGES[:5]) | set(MESSAGES[9:]) <= set(kept)
    assert finish_recording(path) != finished
    assert list(read_recording(path)) == kept
    if not finished:
        by_another_reader(path)


def test_a_finished_recording_again_has_the_times_and_numbers_of_the_first(tmp_path: Path):
    path = tmp_path / "run.mcap"
    unfinished = recorded(path)
    whole = messages_of(path)
    path.write_bytes(unfinished)
    finish_recording(path)
    assert messages_of(path) == whole
    assert whole[-1][0] == 100_000_000 and [one[2] for one in whole] == list(range(21))


def messages_of(path: Path) -> list[tuple[int, int, int, bytes]]:
    with path.open("rb") as file:
        found = [one for _, _, one in make_reader(file).iter_messages(log_time_order=False)]
    return [(one.log_time, one.publish_time, one.sequence, one.data) for one in found]


def test_a_full_disk_keeps_the_whole_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "run.mcap"
    path.write_bytes(recorded(path)[:-3])
    before = list(read_recording(path))

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    assert finish_recording(path)
    assert list(read_recording(path)) == before


def test_unfinished_files_of_dead_processes_go(tmp_path: Path):
    own = tmp_path / f"run.nc.{os.getpid()}.part"
    dead = tmp_path / f"run.mcap.{2**22 + 1}.part"
    for part in (own, dead):
        part.write_bytes(b"unfinished")
    finish_recording(tmp_path / "run.mcap")
    assert [one.name for one in tmp_path.iterdir()] == [own.name]
