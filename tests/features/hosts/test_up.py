"""`concord up`: a network over ssh, by a stand-in for which hosts are folders of this machine.

The same network as files of other programs.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from concord.experiments.__main__ import main
from concord.features.hosts.plan import NetworkPlan, read_plan
from concord.features.hosts.printed import FORMS
from concord.results.folder import read_description
from concord.runtime.drivers import in_this_process
from concord.runtime.network.links import free_ports
from concord.studies.agree import first_difference
from tests.experiments.support import trace_of
from tests.experiments.test_clusters import stand_in
from tests.experiments.units import unit_command
from tests.features.flexray_tools.flexray_support import concord
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


def guarded(folder: Path, *hosts: str) -> NetworkPlan:
    """A plan with keys, for which the routers have these names."""
    pytest.importorskip("cryptography", reason="the extra secure makes certificates")
    write_setup(folder, nodes=3, graph="path")
    main(["keys", str(folder / "keys"), "--nodes", "3", "--hosts", *hosts])
    tables = [
        f'[hosts.{name}]\naddress = "{address}"\nnodes = {nodes}\n'
        for name, address, nodes in zip(("alpha", "beta"), hosts, ([0, 2], [1]), strict=True)
    ]
    file = folder / "guarded.toml"
    file.write_text('keys = "keys"\nenvironment = "beta"\n' + "".join(tables))
    return read_plan(file)


@pytest.mark.zenoh
@pytest.mark.slow
@needs_proc
def test_the_printed_script_runs_the_network(machine: Path):
    write_setup(machine, nodes=2, graph="path", steps=30)
    script = machine / "up.sh"
    script.write_text(FORMS["shell"](read_plan(hosts_file(machine))))
    with (
        family(("sh", str(script), "alpha"), machine) as alpha,
        family(("sh", str(script), "beta"), machine) as beta,
    ):
        assert [one.end(90)[0] for one in (alpha, beta)] == [0, 0]
        assert alpha.gone_at_once() and beta.gone_at_once()
    assert read_description(machine / "runs" / "hosts").run == "hosts"
    assert subprocess.run(["sh", script, "gamma"], capture_output=True).returncode == 2


def without_keys(words: Sequence[str]) -> list[str]:
    place = words.index("--keys")
    return [*words[:place], *words[place + 2 :]]


def test_the_printed_script_installs_what_the_units_need(machine: Path):
    plan = guarded(machine, "alpha.example.org", "beta.example.org")
    (machine / "deploy").symlink_to(Path(__file__).parents[2] / "deploy")
    # The stand-in for systemctl writes down what it is asked for.
    stand_in(machine / "bin", systemctl='#!/bin/sh\necho "$@" >> "$DESTDIR/asked"\n')
    script = machine / "systemd.sh"
    script.write_text(FORMS["systemd"](plan))
    for host, keys, units in (
        ("alpha", {"router", "node-0", "node-2"}, "concord-node@0 concord-node@2\n"),
        (
            "beta",
            {"router", "environment", "recorder", "node-1"},
            "concord-node@1\nstart concord-environment\n",
        ),
    ):
        root = machine / host
        root.mkdir()
        environment = {**os.environ, "DESTDIR": str(root)}
        subprocess.run(["sh", script, host], cwd=machine, env=environment, check=True)
        etc = root / "etc" / "concord"
        assert {file.stem for file in (etc / "keys").iterdir()} == keys
        own = (machine / "keys" / f"router-{host}.example.org.json").read_bytes()
        assert (etc / "keys" / "router.json").read_bytes() == own
        assert (etc / "setup.json").read_bytes() == plan.setup.read_bytes()
        assert (root / "asked").read_text().endswith(f"enable --now concord-router {units}")
        assert (root / "etc" / "systemd" / "system" / "concord-node@.service").is_file()
        variables = dict(
            line.split("=", 1) for line in (etc / "concord.env").read_text().splitlines()
        )
        # The unit's command is the one that `concord up` starts, but for the place of the key.
        unit = {**variables, "CREDENTIALS_DIRECTORY": "credentials"}
        words = unit_command("concord-router.service", unit)
        assert without_keys(words) == without_keys(plan.router(host).words)


def test_the_compose_file_has_a_service_for_each_process(machine: Path):
    yaml = pytest.importorskip("yaml", reason="comes with kubernetes-validate")
    plan = guarded(machine, "alpha.example.org", "beta.example.org")
    services = yaml.safe_load(FORMS["compose"](plan))["services"]
    assert set(services) == {
        "alpha-router", "alpha-node-0", "alpha-node-2",
        "beta-router", "beta-environment", "beta-node-1",
    }  # fmt: skip
    for name, service in services.items():
        program, *words = service["command"]
        assert program == "concord" and set(service.get("depends_on", ())) <= set(services)
        # Each sees setup and its own keys, which exist, at the path that its command names.
        mounted = {}
        for volume in service["volumes"]:
            source, target, *_ = volume.split(":")
            assert source == "runs" or (machine / source).is_file(), name
            mounted[target.removeprefix("/var/lib/concord/")] = source
        named = words[words.index("--keys") + 1]
        assert any(path.startswith(named) for path in mounted)
        assert sum("node-" in path for path in mounted) == ("node" in name)
    aliases = services["beta-router"]["networks"]["default"]["aliases"]
    assert aliases == ["beta.example.org"]
    # Without keys a router is known by the name of its service, as an address cannot be given.
    without = hosts_file(machine, beta="nodes = [1, 2]")
    services = yaml.safe_load(FORMS["compose"](read_plan(without)))["services"]
    assert any(
        word.startswith("tcp/alpha-router:") for word in services["alpha-environment"]["command"]
    )


def test_compose_refuses_certificates_for_addresses(
    machine: Path, capsys: pytest.CaptureFixture[str]
):
    guarded(machine, "10.0.0.1", "10.0.0.2")
    said = concord(capsys, "up", "guarded.toml", "--print", "compose")
    assert said.code == 2 and "services have names" in said.err


def test_the_manifest_is_that_of_deploy_for_as_many_nodes(machine: Path):
    yaml = pytest.importorskip("yaml", reason="comes with kubernetes-validate")
    validator = pytest.importorskip("kubernetes_validate", reason="of the development group")
    items = yaml.safe_load(FORMS["kubernetes"](guarded(machine, "a", "b")))["items"]
    for one in items:
        validator.validate(one, "1.33", strict=True)
    [nodes] = [one["spec"] for one in items if one["metadata"]["name"] == "concord-nodes"]
    assert (nodes["completions"], nodes["parallelism"]) == (3, 3)


@pytest.mark.parametrize("form", ["systemd", "kubernetes"])
def test_forms_that_need_keys_say_so(form: str, machine: Path, capsys: pytest.CaptureFixture[str]):
    write_setup(machine, nodes=2, graph="path")
    said = concord(capsys, "up", hosts_file(machine), "--print", form)
    assert said.code == 2 and f"--print {form}: its files expect keys" in said.err
