"""`concord up`: a network over ssh, by a stand-in for which hosts are folders of this machine."""

import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from concord.results.folder import read_description
from concord.runtime.drivers import in_this_process
from concord.runtime.network.links import free_ports
from concord.studies.agree import first_difference
from tests.experiments.command_support import concord
from tests.experiments.support import trace_of
from tests.experiments.test_clusters import stand_in
from tests.features.hosts.test_hosts import write_setup
from tests.processes import CONCORD, PATIENCE_S, PROC, Family, family

needs_proc = pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc")
# The command runs here, in a home of the host's own, as sshd starts it.
SSH = """#!/bin/sh
while [ "$1" != -- ]; do shift; done
[ "$2" = nowhere ] && { echo "ssh: no route to nowhere" >&2; exit 255; }
mkdir -p "$HOSTS/$2"
cd "$HOSTS/$2"
exec sh -c "$3"
"""
PROGRAM = f'#!/bin/sh\nexec {sys.executable} -m concord.experiments "$@"\n'


def hosts_file(folder: Path, more: str = "", beta: str = "nodes = [1]", head: str = "") -> Path:
    """Two hosts with a node each, on free ports."""
    ports = free_ports(["alpha", "beta"])
    file = folder / "hosts.toml"
    file.write_text(
        f'{head}\n[hosts.alpha]\naddress = "127.0.0.1"\nport = {ports["alpha"]}\n'
        f'ssh = "me@alpha"\nnodes = [0]\n'
        f'[hosts.beta]\naddress = "localhost"\nport = {ports["beta"]}\n{beta}\n{more}\n'
    )
    return file


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine with concord and the stand-in for ssh; its folder."""
    binaries = tmp_path / "bin"
    binaries.mkdir()
    environment = stand_in(binaries, ssh=SSH, concord=PROGRAM)
    monkeypatch.setenv("PATH", environment["PATH"])
    monkeypatch.setenv("HOSTS", str(tmp_path / "there"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def up(file: Path, *words: str) -> tuple[str, ...]:
    return (*CONCORD, "up", str(file), *words)


@pytest.mark.zenoh
@pytest.mark.slow
@needs_proc
def test_a_network_over_ssh_has_the_bits_of_one_process_and_one_log(machine: Path):
    write_setup(machine, nodes=2, graph="path", steps=30)
    with family(up(hosts_file(machine), "--json"), machine) as network:
        code, out, err = network.end(90)
        assert (code, out[:1], out[-2:]) == (0, "{", "}\n"), err
        assert network.gone_at_once()
    lines = {tuple(line.split(" | ")[0].split()) for line in err.splitlines() if " | " in line}
    assert lines == {
        ("alpha", "router"), ("alpha", "environment"), ("alpha", "node", "0"),
        ("beta", "router"), ("beta", "node", "1"),
    }  # fmt: skip
    results = machine / "there" / "me@alpha" / "concord-hosts" / "results"
    assert "results in alpha:concord-hosts/results" in err
    assert not (machine / "there" / "localhost" / "concord-hosts" / "results").exists()
    description = read_description(results)
    in_this_process(description.setup, "one", machine / "one.mcap", None, lambda step: None)
    one = trace_of(description.setup, machine / "one.mcap")
    several = trace_of(description.setup, results / "run.mcap")
    assert first_difference(one, several, "up") is None


def ends_by_interruption(network: Family) -> None:
    network.send(signal.SIGINT)
    code, _, err = network.end(30)
    assert code == 130 and "alpha environment | interrupted" in err, err


def ends_by_death(network: Family) -> None:
    network.send(signal.SIGKILL)
    network.process.wait()


@pytest.mark.zenoh
@pytest.mark.slow
@needs_proc
@pytest.mark.parametrize("end", [ends_by_interruption, ends_by_death])
def test_a_node_is_killed_and_restarted_and_all_end_with_the_command(
    end: Callable[[Family], None], machine: Path
):
    write_setup(machine, nodes=2, graph="path", steps=10_000)
    with family(up(hosts_file(machine)), machine, interactive=True) as network:
        typed = network.process.stdin
        assert typed is not None

        def write(line: str) -> None:
            typed.write(f"{line}\n")
            typed.flush()

        network.await_line("beta node 1       | run hosts: nodes 1 look for it")
        write("kill 2")
        network.await_line("'kill 2' is no command")
        write("kill 1")
        assert "beta node 1       | ended with exit code 137; `restart 1`" in network.await_line(
            "137"
        )
        write("kill 1")
        network.await_line("node 1 does not run")
        write("restart 1")
        network.await_line("beta node 1       | run hosts: nodes 1 look for it")
        # A node that runs is killed first.
        write("restart 1")
        network.await_line("beta node 1       | Killed")
        network.await_line("beta node 1       | run hosts: nodes 1 look for it")
        # With the node the network goes on.
        network.await_line("alpha environment | oscillator: ", 120)
        end(network)
        assert network.gone_within(PATIENCE_S)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"beta": "nodes = [0, 1]"}, "node 0 is named twice"),
        ({"beta": "nodes = [1, 7]"}, "node 7 is named twice or unknown; name each of 0 to 1"),
        ({"beta": ""}, "node 1 is on no host"),
        ({"beta": "node = [1]"}, "unknown field `node`"),
        ({"head": 'environment = "gamma"'}, "environment 'gamma' is no host; choose one of alpha"),
        ({"head": 'setup = "none.json"'}, "none.json: cannot be read"),
        ({"head": 'keys = "keys"'}, "router-127.0.0.1.json: no such file"),
        ({"more": '[hosts."a b"]\naddress = "a"'}, "host 'a b'"),
        ({"more": '[hosts.gamma]\naddress = "a"\nssh = "-oProxyCommand=x"'}, "host 'gamma'"),
        ({"more": '[hosts.gamma]\naddress = "a"\nport = 99999'}, "host gamma: tcp/a:99999"),
        ({"more": "[hosts"}, "not a file of hosts"),
    ],
)
def test_a_file_that_cannot_be_is_refused(
    arguments: dict[str, str], named: str, machine: Path, capsys: pytest.CaptureFixture[str]
):
    write_setup(machine, nodes=2, graph="path")
    said = concord(capsys, "up", hosts_file(machine, **arguments))
    assert said.code == 2 and named in said.err
    # Nothing was started.
    assert not (machine / "there").exists()


@pytest.mark.parametrize(
    ("beta", "named"),
    [
        ('ssh = "nowhere"', "ssh nowhere ended with exit code 255 (ssh: no route to nowhere)"),
        ('concord = "concorde"', "(concorde not found)"),
    ],
)
def test_a_host_that_cannot_be_reached_is_named(
    beta: str, named: str, machine: Path, capsys: pytest.CaptureFixture[str]
):
    write_setup(machine, nodes=2, graph="path")
    said = concord(capsys, "up", hosts_file(machine, beta=f"nodes = [1]\n{beta}"))
    assert said.code == 2 and "host beta: ssh " in said.err and named in said.err


# --- The same network as files of other programs -------------------------------------------------
