"""Test that a machine exposes no port by default, and that a file cannot make it run code."""

import socket
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from concord.experiments.cli import dashboard as dashboard_command
from concord.runtime.network.network_file import NetworkAddresses, read_network, write_network
from concord.studies.sweep.store import folder_of, load_arrays, save_arrays
from tests.experiments.command_support import concord
from tests.features.hosts.test_hosts import write_setup
from tests.processes import CONCORD, PROC, Family, family, holds_within

_LISTENING = "0A"


def addresses(run: Family) -> set[str]:
    """Return the addresses on which a command and its child processes listen."""
    sockets = set()
    for pid in run.alive():
        for file in (PROC / str(pid) / "fd").iterdir():
            try:
                sockets.add(str(file.readlink()))
            except OSError:  # closed meanwhile
                continue
    found = set()
    for name, kind, size in (("tcp", socket.AF_INET, 4), ("tcp6", socket.AF_INET6, 16)):
        for line in (PROC / "net" / name).read_text().splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if state == _LISTENING and f"socket:[{rest[5]}]" in sockets:
                words = bytes.fromhex(local.partition(":")[0])
                # Words of four bytes, each the other way round.
                packed = b"".join(words[at : at + 4][::-1] for at in range(0, size, 4))
                found.add(socket.inet_ntop(kind, packed))
    return found


@pytest.mark.zenoh
@pytest.mark.slow
@pytest.mark.skipif(not (PROC / "net").is_dir(), reason="finds sockets in /proc")
@pytest.mark.parametrize("graph", ["ring", "complete"])
def test_network_router_and_page_listen_on_loopback_alone(tmp_path: Path, graph: str):
    """A mesh of peers, and a graph so dense that it has a router; with the page beside them."""
    words = f"--scenario oscillator --nodes 12 --graph {graph} --steps 100000 --out run"
    command = [*CONCORD, "run", *words.split(), "--driver", "processes", "--dashboard"]
    with family(command, tmp_path) as run:
        run.await_line("dashboard at http://127.0.0.1:", 60)
        pids = read_network(tmp_path / "run").pids
        assert ("router" in pids) == (graph == "complete")
        assert holds_within(20, lambda: len(addresses(run)) > 0)
        assert addresses(run) == {"127.0.0.1"}


@pytest.mark.parametrize(
    "name", ["../x", "..", "/x", "a/b", "*", "a/**", "$*", "a\\n", "", "x" * 101]
)
def test_a_name_that_is_none_is_refused_wherever_it_comes_from(
    name: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    """It becomes a folder and a part of every key: on the command line, in a setup, in a run's
    folder."""
    # The command lowers the priority of its process, which here runs all tests.
    monkeypatch.setattr(dashboard_command, "give_way", lambda niceness: None)
    setup = write_setup(tmp_path)
    hostile = tmp_path / "hostile.json"
    told: dict[str, Any] = msgspec.json.decode(setup.read_bytes())
    hostile.write_bytes(msgspec.json.encode({**told, "run": name}))
    write_network(tmp_path, NetworkAddresses(name, ["tcp/127.0.0.1:1"]))
    at = ("--connect", "tcp/127.0.0.1:1")
    for words in (
        ["setup", "--out", str(tmp_path / "new.json"), f"--name={name}"],
        ["environment", str(hostile), *at],
        ["node", str(hostile), "1", *at],
        ["control", str(tmp_path), "pause"],
        ["dashboard", *at, f"--run={name}"],
    ):
        said = concord(capsys, *words)
        assert said.code == 2 and "a name has 1 to 100 letters" in said.err, words
    assert not (tmp_path / "new.json").exists()


class _Trap:
    """Object that creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_a_piece_that_must_be_unpickled_is_not_read(tmp_path: Path):
    sprung = tmp_path / "sprung"
    folder = folder_of(tmp_path / "sweep.nc")
    folder.mkdir()
    save_arrays(folder, "sound", {"figures": np.zeros(3)})
    objects = np.array([_Trap(sprung)], dtype=object)
    np.savez(folder / "trap.npz", figures=objects)
    assert load_arrays(folder, "sound") is not None
    assert load_arrays(folder, "trap") is None
    assert not sprung.exists()
    # Unpickling would have made this call.
    made, arguments = objects[0].__reduce__()
    made(*arguments)
    assert sprung.exists()
