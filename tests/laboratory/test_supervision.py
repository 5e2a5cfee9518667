"""A supervisor and its child are killed, stopped or interrupted together: nothing is left."""

import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from concord.runtime.network.network_file import read_network
from concord.runtime.network.sockets import socket_folder
from tests.processes import CONCORD, PROC, family, holds_within

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]

# Processes are gone within so long on an idle machine.
GONE_S = 10.0
SIGNALS = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP, "interrupt": signal.SIGINT}
# Each signal once for the supervisor and once for its child.
BOTH = [("kill", "stop"), ("stop", "interrupt"), ("interrupt", "kill")]
PAIRS = [("launcher", "launcher process"), ("launcher process", "1")]


@pytest.fixture
def sockets() -> Iterator[Path]:
    """Return an empty folder with a short name."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        yield Path(folder)


def parent_of(pid: int) -> int:
    """Return the parent's process number."""
    return int((PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[1])


@pytest.mark.parametrize(("supervisor", "child"), PAIRS)
@pytest.mark.parametrize(("first", "second"), BOTH)
def test_nothing_is_left_of_a_supervisor_and_its_child(
    tmp_path: Path,
    sockets: Path,
    monkeypatch: pytest.MonkeyPatch,
    supervisor: str,
    child: str,
    first: str,
    second: str,
):
    """Where the network goes on, its launcher is killed a second later."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(sockets))
    words = "run --scenario oscillator --nodes 3 --steps 10000 --driver processes --out run"
    with family((*CONCORD, *words.split()), tmp_path) as run:
        there = tmp_path / "run" / "network.json"
        assert holds_within(60, there.is_file)
        run.await_line("oscillator: ")
        pids = read_network(tmp_path / "run").pids
        pids |= {"launcher": run.process.pid, "launcher process": parent_of(pids["environment"])}
        os.kill(pids[child], SIGNALS[second])
        os.kill(pids[supervisor], SIGNALS[first])
        time.sleep(1.0)
        if run.process.poll() is None:
            run.process.kill()
        began_s = time.monotonic()
        assert run.gone_within(GONE_S), run.alive()
        sys.stdout.write(
            f"{supervisor} {first}, {child} {second}: {time.monotonic() - began_s:.1f} s\n"
        )
    with socket_folder():
        assert len(list(sockets.iterdir())) == 1
    assert not list(sockets.iterdir())
