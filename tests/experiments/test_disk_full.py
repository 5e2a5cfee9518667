"""A disk that is full: which file is said, the network ends, and what was written can be read."""

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.disk import NotWritten
from concord.results.folder import read_description
from concord.results.palette import save
from concord.results.records.netcdf_file import ARRAYS, RECORDING
from concord.results.records.trace import read_trace
from concord.runtime.recording import McapRecorder, read_recording
from concord.studies.sweep.store import folder_of, load_arrays, save_arrays
from tests.processes import CONCORD, PROC, family

pytestmark = pytest.mark.slow

RUN = ["run", "--scenario", "oscillator", "--nodes", "4", "--out", "run"]
# A run of so many steps fills a disk of this size long before its end.
DISK_KIB, STEPS = 300, "5000"


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own with little room."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if sys.platform != "linux" or os.getuid() != 0:
        pytest.skip("only root of a Linux machine can mount a small disk")
    size = ["-o", f"size={DISK_KIB}k"]
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", *size, "tmpfs", str(disk)],
        capture_output=True,
        text=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {mounted.stderr.strip()}")
    try:
        yield disk
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)


def complete_steps(folder: Path) -> int:
    """Steps in what a run has left."""
    description = read_description(folder)
    return read_trace(description.setup, read_recording(folder / RECORDING)).steps


@pytest.mark.zenoh
@pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there")
@pytest.mark.parametrize("driver", ["in-process", "processes"])
def test_a_run_on_a_full_disk_ends_with_what_it_has(small_disk: Path, driver: str):
    with family([*CONCORD, *RUN, "--steps", STEPS, "--driver", driver], small_disk) as run:
        code, out, err = run.end(60)
        assert run.gone_within(1.0)
    assert (code, out) == (1, "")
    assert "Traceback" not in err
    assert "run.mcap cannot be written (No space left on device); make room" in err
    assert "concord collect run" in err
    steps = complete_steps(small_disk / "run")
    assert 10 < steps < int(STEPS)


def test_a_result_that_does_not_fit_leaves_the_recording_and_no_broken_file(small_disk: Path):
    room = small_disk / "filler"
    command = [*CONCORD, *RUN, "--steps", "30"]
    with family(command, small_disk) as run:
        assert run.end(60)[0] == 0
    (small_disk / "run" / ARRAYS).unlink()
    # Files take whole pages of the disk.
    room.write_bytes(bytes(shutil.disk_usage(small_disk).free - 8192))
    with family([*CONCORD, "collect", "run"], small_disk) as collect:
        code, out, err = collect.end(60)
    assert (code, out) == (1, "")
    assert "Traceback" not in err and "cannot be written (No space left on device)" in err
    assert {file.name for file in (small_disk / "run").iterdir()} <= {
        "run.json", "run.mcap", "bus.pcap"
    }  # fmt: skip
    room.unlink()
    with family([*CONCORD, "collect", "run"], small_disk) as collect:
        assert collect.end(60)[0] == 0
    assert complete_steps(small_disk / "run") == 30


def test_a_sweep_on_a_full_disk_keeps_its_finished_pieces(small_disk: Path):
    words = "sweep --scenario oscillator --nodes 3,4,5,6 --steps 1000 --runs 2 --workers 1 -o s.nc"
    with family([*CONCORD, *words.split()], small_disk) as sweep:
        code, out, err = sweep.end(120)
        assert sweep.gone_within(1.0)
    assert (code, out) == (1, "")
    assert "Traceback" not in err
    assert "cannot be written (No space left on device)" in err and "are kept; go on with: " in err
    folder = folder_of(small_disk / "s.nc")
    kept = [load_arrays(folder, path.stem) for path in folder.glob("*.npz")]
    assert 0 < len(kept) < 4 and None not in kept
    assert not list(folder.glob("*.part"))


@pytest.fixture
def few_bytes() -> Iterator[int]:
    """No file of this process may be longer than this, as under a quota."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    limit = 26_000
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield limit
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_recorder_that_meets_a_limit_keeps_every_whole_message(tmp_path: Path, few_bytes: int):
    path = tmp_path / "run.mcap"
    recorder = McapRecorder(path, 1, 0.1, SHARE_FRAMES)
    kept = 0
    with pytest.raises(NotWritten, match=r"run\.mcap cannot be written \(File too large\)"):
        while True:
            recorder.record([("bid/0", b"%d" % kept)])
            kept += 1
    recorder.close()
    assert [data for _, data in read_recording(path)] == [b"%d" % n for n in range(kept)]
    assert kept > 50 and path.stat().st_size <= few_bytes


def test_of_messages_that_come_together_those_before_the_limit_are_kept(
    tmp_path: Path, few_bytes: int
):
    path = tmp_path / "run.mcap"
    recorder = McapRecorder(path, 1, 0.1, SHARE_FRAMES)
    messages = [("bid/0", b"%d" % n) for n in range(few_bytes)]
    with pytest.raises(NotWritten, match=r"run\.mcap"):
        recorder.record(messages)
    read = list(read_recording(path))
    assert read == messages[: len(read)] and len(read) > 50
    # Cut off where the last whole one ends: what follows it is as long as any other.
    one_bytes = len(b"%d" % len(read)) + 31
    assert few_bytes - one_bytes < path.stat().st_size <= few_bytes


def test_an_index_that_does_not_fit_is_left_out(tmp_path: Path):
    path = tmp_path / "run.mcap"
    recorder = McapRecorder(path, 1, 0.1, SHARE_FRAMES)
    for n in range(100):
        recorder.record([("bid/0", b"%d" % n)])
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 10, before[1]))
    try:
        with pytest.raises(NotWritten, match=r"run\.mcap"):
            recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(list(read_recording(path))) == 100


def test_a_picture_that_does_not_fit_is_named(tmp_path: Path, few_bytes: int):
    figure = plt.figure()
    # A byte of noise stays a byte under any compression.
    figure.figimage(np.random.default_rng(0).random((300, few_bytes // 75)), cmap="gray")
    with pytest.raises(NotWritten, match=r"noise\.png cannot be written"):
        save(figure, tmp_path / "noise.png")


def test_a_piece_that_does_not_fit_is_not_there(tmp_path: Path, few_bytes: int):
    with pytest.raises(NotWritten, match=r"piece\.npz"):
        save_arrays(tmp_path, "piece", {"figures": np.zeros(few_bytes)})
    assert not list(tmp_path.iterdir())
