"""Unix sockets of a network: their user alone opens them, and none is left behind."""

import os
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from concord.runtime.drivers import in_this_process
from concord.runtime.network.network_file import NetworkAddresses, read_network
from concord.runtime.network.sockets import in_folder, socket_folder
from concord.runtime.processes.job import Happened
from concord.runtime.processes.launcher import run_processes
from concord.studies.agree import first_difference
from tests.experiments.support import small, trace_of
from tests.processes import CONCORD, PATIENCE_S, PROC, family, holds_within

STRANGER = 65534
# The process becomes another user when it has read its modules.
ASK = """
import os, socket, sys
from concord.runtime.network.control_client import Client, NotThere
uid, run, *connect = sys.argv[1:]
os.setgroups([])
os.setgid(int(uid))
os.setuid(int(uid))
for endpoint in connect:
    try:
        socket.socket(socket.AF_UNIX).connect(endpoint.removeprefix("unixsock-stream/"))
        print("open")
    except PermissionError:
        print("closed")
try:
    print(Client(connect, run).state()["run"])
except NotThere:
    print("no network")
"""
# A launcher makes a folder; a launcher process holds the one that is named.
HOLD = """
import sys, time
from concord.runtime.network.sockets import hold, socket_folder
if sys.argv[1]:
    hold(sys.argv[1])
    print("held", flush=True)
    time.sleep(600)
with socket_folder() as folder:
    print(folder, flush=True)
    time.sleep(600)
"""


class Asked(Exception):
    """All is known: the network may end."""


def asked(uid: int, network: NetworkAddresses) -> list[str]:
    """Return what a process of this user is told: of each socket, and by the network."""
    command = (sys.executable, "-c", ASK, str(uid), network.run, *network.connect)
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\n")


def paths(endpoints: list[str]) -> list[str]:
    return [endpoint.removeprefix("unixsock-stream/") for endpoint in endpoints]


def test_the_folder_is_private_and_goes():
    with socket_folder() as folder:
        assert stat.S_IMODE(Path(folder).stat().st_mode) == 0o700
        # A user may have a permissive mask; two networks at once have two folders.
        with socket_folder() as other:
            assert other != folder
    assert not Path(folder).exists()


@pytest.fixture
def short_folder() -> Iterator[Path]:
    """A folder whose name leaves room for that of a socket, as pytest's own need not."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        yield Path(folder)


def test_the_next_network_removes_what_killed_ones_have_left(
    short_folder: Path, monkeypatch: pytest.MonkeyPatch
):
    """Folders that a process holds stay, and so do those of other programs."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(short_folder))
    foreign = short_folder / "concord-abcdefgh"
    foreign.mkdir(0o700)
    command = [sys.executable, "-c", HOLD]
    launcher = subprocess.Popen([*command, ""], stdout=subprocess.PIPE, text=True)
    assert launcher.stdout is not None
    left = Path(launcher.stdout.readline().strip())
    process = subprocess.Popen([*command, str(left)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline()
    launcher.kill()
    launcher.wait()
    with socket_folder() as other:
        assert left.is_dir() and Path(other).parent == left.parent == short_folder
    process.kill()
    process.wait()
    assert left.is_dir()
    with socket_folder() as other:
        assert not left.exists() and Path(other).is_dir()
    assert list(short_folder.iterdir()) == [foreign]
    for one in (launcher, process):
        assert one.stdout is not None
        one.stdout.close()


@pytest.mark.parametrize("name", ["long" * 30, "with # and ;"])
def test_a_folder_that_no_socket_can_have_is_passed_over(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / name).mkdir()
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / name))
    with socket_folder() as folder:
        assert not folder.startswith(str(tmp_path))
        (path,) = paths(list(in_folder(folder, ["recorder"]).values()))
        with socket.socket(socket.AF_UNIX) as door:
            door.bind(f"{path}.lock")


def test_no_folder_is_one_sentence(monkeypatch: pytest.MonkeyPatch):
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryDirectory", full)
    with pytest.raises(ValueError, match=r"^sockets: no folder .* with --port 0$"), socket_folder():
        pass


@pytest.mark.zenoh
@pytest.mark.skipif(os.getuid() != 0, reason="another user's process needs root")
@pytest.mark.parametrize(("graph", "nodes"), [("ring", 4), ("complete", 10)])
def test_another_user_gets_nothing(tmp_path: Path, graph: str, nodes: int):
    """Neither a connection nor an answer; the user of the network gets both."""
    setup = small(graph=graph, nodes=nodes, steps=100_000)
    said: dict[int, list[str]] = {}
    folders: list[Path] = []

    def look(happened: Happened) -> None:
        if happened.what == "ready":
            network = read_network(tmp_path)
            folders.append(Path(paths(network.connect)[0]).parent)
            assert stat.S_IMODE(folders[0].stat().st_mode) == 0o700
            said.update({uid: asked(uid, network) for uid in (0, STRANGER)})
            raise Asked

    with pytest.raises(Asked):
        run_processes(setup, "private", tmp_path / "run.mcap", None, look)
    assert said == {
        0: ["open", "open", "private", ""],
        STRANGER: ["closed", "closed", "no network", ""],
    }
    assert not folders[0].exists()


@pytest.mark.zenoh
@pytest.mark.parametrize("port", [None, 0])
def test_sockets_and_ports_carry_the_same_run(tmp_path: Path, port: int | None):
    setup = small(steps=20)
    connect: list[str] = []
    run_processes(
        setup,
        "same",
        tmp_path / "run.mcap",
        port,
        lambda happened: connect.extend(happened.connect),
    )
    kinds = {endpoint.split("/", 1)[0] for endpoint in connect}
    assert kinds == {"unixsock-stream" if port is None else "tcp"}
    in_this_process(setup, "one", tmp_path / "one.mcap", None, lambda step: None)
    one, many = (trace_of(setup, tmp_path / f"{name}.mcap") for name in ("one", "run"))
    assert first_difference(one, many, "processes") is None


@pytest.mark.zenoh
@pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there")
def test_the_folder_goes_although_the_launcher_was_killed(tmp_path: Path):
    """The launcher process removes it at the end of its lifeline."""
    words = "run --scenario oscillator --nodes 3 --steps 100000 --driver processes --out run"
    with family((*CONCORD, *words.split()), tmp_path) as run:
        there = tmp_path / "run" / "network.json"
        assert holds_within(PATIENCE_S, there.is_file)
        folder = Path(paths(read_network(tmp_path / "run").connect)[0]).parent
        assert folder.is_dir()
        run.process.kill()
        assert holds_within(PATIENCE_S, lambda: not folder.exists())
