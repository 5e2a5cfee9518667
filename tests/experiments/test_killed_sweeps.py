"""A sweep over Dask whose client, workers and scheduler are killed goes on to the same bits."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import concord as cc
from concord.studies.sweep.store import folder_of
from tests.pages import ROOT
from tests.processes import PATIENCE_S, holds_within

pytestmark = pytest.mark.slow

WORKERS, PIECES = 2, 16
# Each cell is a piece of some tenths of a second.
WORDS = [
    *("sweep", "--scenario", "oscillator", "--nodes", "4", "--steps", "60"),
    *("--seed", f"1..{PIECES}", "--runs", "400", "--keep", "moments"),
]
# A worker writes the name of a piece that it begins; Dask runs this file twice in a process.
TOLD = """
import os
from concord.studies.sweep import pieces
def told(piece, compute=pieces.compute):
    with open(os.environ["BEGUN"], "a") as file:
        file.write(pieces.digest_of(piece, {}, pieces.program()) + "\\n")
    return compute(piece)
if pieces.compute.__name__ == "compute":
    pieces.compute = told
"""


class Cluster:
    """A scheduler of Dask, two workers, and the client of a sweep, each in a session of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out, self.begun = folder, folder / "s.nc", folder / "begun"
        (folder / "told.py").write_text(TOLD)
        self.begun.touch()
        self.scheduler = self._scheduler()
        self.workers = [self._worker() for _ in range(WORKERS)]
        self.client = self._client()

    @property
    def address(self) -> str:
        place = self.folder / "scheduler.json"
        assert holds_within(
            PATIENCE_S, lambda: place.exists() and place.read_text().strip()[-1:] == "}"
        )
        return json.loads(place.read_text())["address"]

    @property
    def stored(self) -> set[str]:
        return {piece.stem for piece in folder_of(self.out).glob("*.npz")}

    @property
    def started(self) -> list[str]:
        return self.begun.read_text().split()

    def lose(self, what: str) -> None:
        """Kill one of them without a word, and start it again."""
        if what == "scheduler":
            _kill(self.scheduler)
            assert self.client.wait(120) == 1
            # Workers of Dask end without their scheduler.
            for worker in self.workers:
                _kill(worker)
            self.scheduler = self._scheduler()
            self.workers = [self._worker() for _ in range(WORKERS)]
            self.client = self._client()
        elif what == "worker":
            _kill(self.workers.pop(0))
            self.workers.append(self._worker())
        else:
            _kill(self.client)
            self.client = self._client()

    def close(self) -> None:
        for process in (self.client, *self.workers, self.scheduler):
            _kill(process)

    def _scheduler(self) -> subprocess.Popen[bytes]:
        place = self.folder / "scheduler.json"
        place.unlink(missing_ok=True)
        return self._start(
            "dask", "scheduler", "--host", "127.0.0.1", "--port", "0",
            "--dashboard-address", "127.0.0.1:0", "--scheduler-file", str(place),
        )  # fmt: skip

    def _worker(self) -> subprocess.Popen[bytes]:
        return self._start(
            "dask", "worker", self.address, "--nthreads", "1", "--no-dashboard", "--death-timeout",
            "600", "--local-directory", str(self.folder), "--preload", str(self.folder / "told.py"),
        )  # fmt: skip

    def _client(self) -> subprocess.Popen[bytes]:
        # A scheduler that has begun again waits for its workers.
        code = (
            "import sys; from distributed import Client\n"
            f"with Client(sys.argv[-1], timeout=120) as c: c.wait_for_workers({WORKERS}, 120)\n"
            "from concord.experiments.__main__ import main; main(sys.argv[1:])"
        )
        words = [*WORDS, "-o", str(self.out), "--dask", self.address]
        return self._start("-c", code, *words)

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        program = [sys.executable, *(() if words[0] == "-c" else ("-m",)), *words]
        with (self.folder / "said").open("ab") as said:
            return subprocess.Popen(
                program, cwd=ROOT, env={**os.environ, "BEGUN": str(self.begun)},
                start_new_session=True, stdout=said, stderr=said,
            )  # fmt: skip


def _kill(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def test_a_sweep_killed_at_random_moments_goes_on_to_the_same_bits(tmp_path: Path):
    pytest.importorskip("distributed")
    drawn, flying, cluster = random.Random(18), 0, Cluster(tmp_path)
    try:
        for what in ("client", "worker", "scheduler"):
            # One piece more, and then some: no start of the sweep is for nothing.
            before = len(cluster.stored)
            assert holds_within(PATIENCE_S, lambda: len(cluster.stored) > before)  # noqa: B023
            time.sleep(drawn.uniform(0, 0.3))
            flying += len(set(cluster.started) - cluster.stored)
            cluster.lose(what)
        assert holds_within(PATIENCE_S, lambda: cluster.client.poll() is not None)
        assert cluster.client.returncode == 0, (tmp_path / "said").read_text()
    finally:
        cluster.close()
    started = cluster.started
    assert len(set(started)) == PIECES
    assert len(started) - PIECES <= flying
    alone = tmp_path / "alone.nc"
    subprocess.run(
        [sys.executable, "-m", "concord.experiments", *WORDS, "--workers", "1", "-o", str(alone)],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    with cc.load(alone) as one, cc.load(cluster.out) as other:
        for name in one:
            assert one[name].to_numpy().tobytes() == other[name].to_numpy().tobytes(), name
