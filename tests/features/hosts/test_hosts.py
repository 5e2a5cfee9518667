"""One network on several hosts, here as several commands on one: the same bits, clear refusals."""

import signal
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from concord.dashboard.frames.live import LiveNetwork
from concord.experiments.__main__ import main
from concord.features.hosts.access_control import MONITOR, OPERATOR
from concord.results.folder import read_description, read_description_file
from concord.runtime.drivers import in_this_process
from concord.runtime.network.control_client import Client, NotThere
from concord.runtime.network.links import ZenohEndpoints, checked_endpoints, checked_run, free_ports
from concord.runtime.network.zenoh_transport import Transport
from concord.studies.agree import first_difference
from tests.experiments.command_support import concord
from tests.experiments.support import trace_of
from tests.features.hosts.hosts import Hosts, hosts
from tests.processes import PATIENCE_S, PROC, holds_within

needs_proc = pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc")


def write_setup(
    folder: Path, *words: object, nodes: int = 4, graph: str = "ring", steps: int = 40
) -> Path:
    file = folder / "setup.json"
    scenario = ("--scenario", "oscillator", "--nodes", nodes, "--graph", graph, "--steps", steps)
    main(["setup", *map(str, (*scenario, "--out", file, "--name", "hosts", *words))])
    return file


def two_routers(there: Hosts) -> tuple[str, str]:
    ports = free_ports(["a", "b"])
    a, b = (f"tcp/127.0.0.1:{ports[name]}" for name in "ab")
    there.router(a)
    there.router(b, a)
    return a, b


def await_network(endpoint: str, keys: str | None = None) -> Client:
    """Return a client as soon as the environment answers it."""
    client = Client([endpoint], "hosts", keys)

    def answers() -> bool:
        with suppress(NotThere):
            client.state()
            return True
        return False

    assert holds_within(PATIENCE_S, answers)
    return client


@needs_proc
@pytest.mark.zenoh
def test_a_signal_ends_a_router_whichever_thread_gets_it(tmp_path: Path):
    with hosts(tmp_path) as there:
        router = there.router(f"tcp/127.0.0.1:{free_ports(['a'])['a']}")
        router.send_to_a_thread(signal.SIGTERM)
        assert router.gone_within(PATIENCE_S)
        assert router.end()[0] == 130


@needs_proc
@pytest.mark.zenoh
def test_nodes_that_never_meet_their_environment_end(tmp_path: Path):
    setup = write_setup(tmp_path)
    with hosts(tmp_path) as there:
        a, _ = two_routers(there)
        nodes = there.concord("node", setup, 0, 1, "--connect", a, "--peer-timeout", 2)
        code, out, err = nodes.end(60)
        assert (code, out) == (1, "")
        assert "the environment has been out of reach for 2 s" in err


@needs_proc
@pytest.mark.zenoh
def test_commands_on_several_hosts_give_the_bits_of_one_process(tmp_path: Path):
    setup = write_setup(tmp_path)
    with hosts(tmp_path) as there:
        a, b = two_routers(there)
        nodes = [
            there.concord("node", setup, 0, 1, "--connect", b),
            there.concord("node", setup, 2, 3, "--connect", a),
        ]
        environment = there.concord(
            "environment", setup, "--connect", a, "--out", tmp_path / "run", "--json"
        )
        code, out, err = environment.end(60)
        assert (code, out[:1]) == (0, "{"), err
        assert [node.end(10)[0] for node in nodes] == [0, 0]
    description = read_description(tmp_path / "run")
    assert description.run == "hosts"
    in_this_process(description.setup, "one", tmp_path / "one.mcap", None, lambda step: None)
    one = trace_of(description.setup, tmp_path / "one.mcap")
    several = trace_of(description.setup, tmp_path / "run" / "run.mcap")
    assert several.steps == 40
    assert first_difference(one, several, "hosts") is None


@needs_proc
@pytest.mark.zenoh
def test_what_is_no_message_ends_nobody_and_changes_no_bit(tmp_path: Path):
    """Without keys, a network accepts a client that breaks every rule and must tolerate it.

    Another setup, sent in the name of a node before the run, would end the run. That message counts
    as the node's own.
    """
    setup = write_setup(tmp_path)
    with hosts(tmp_path) as there:
        endpoint, _ = two_routers(there)
        there.concord("node", setup, 0, 1, 2, "--connect", endpoint)
        environment = there.concord(
            "environment", setup, "--connect", endpoint, "--out", tmp_path / "run", "--json"
        )
        await_network(endpoint).close()
        stranger = Transport("hosts", ZenohEndpoints("client", (), (endpoint,), 5.0), [], 1)
        try:
            for topic in (
                *("event", "estimate/x", "estimate/1", "estimate/99", "finished", "share/x"),
                *("share/1", "share/99", "hello/x", "bid/1", "truth", "measured/1"),
                *("grant", "gone/x", "welcome/1", "x/y/z", "recorded/x", "unreachable/x"),
            ):
                for data in (b"", b"nonsense", b"{}", b"[1]", b"\xff" * 300):
                    stranger.send(topic, data)
            there.concord("node", setup, 3, "--connect", endpoint)
            code, out, err = environment.end(60)
        finally:
            stranger.close()
        assert (code, out[:1]) == (0, "{"), err
        assert "Traceback" not in err
    description = read_description(tmp_path / "run")
    in_this_process(description.setup, "one", tmp_path / "one.mcap", None, lambda step: None)
    one = trace_of(description.setup, tmp_path / "one.mcap")
    several = trace_of(description.setup, tmp_path / "run" / "run.mcap")
    np.testing.assert_array_equal(several.mean, one.mean)
    np.testing.assert_array_equal(several.cov, one.cov)


@pytest.mark.slow
@needs_proc
@pytest.mark.zenoh
def test_who_may_look_on_and_who_may_command_a_guarded_network(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """The keys of monitor and operator, to a network whose environment and nodes have theirs."""
    pytest.importorskip("cryptography", reason="the extra secure makes certificates")
    keys = tmp_path / "keys"
    main(["keys", str(keys), "--nodes", "4"])
    setup = write_setup(tmp_path, steps=100_000)
    endpoint = f"tls/localhost:{free_ports(['router'])['router']}"

    def control(*words: str) -> tuple[int, str]:
        capsys.readouterr()
        said = concord(capsys, "control", tmp_path / "run", *words)
        return said.code, said.out + said.err

    with hosts(tmp_path) as there:
        router = there.concord("router", "--listen", endpoint, "--keys", keys / "router.json")
        router.await_line("router at")
        joining = ("--connect", endpoint, "--keys", keys)
        there.concord("node", setup, 0, 1, 2, 3, *joining)
        there.concord("environment", setup, *joining, "--out", tmp_path / "run")
        monitor, operator = (("--keys", str(keys / f"{who}.json")) for who in (MONITOR, OPERATOR))

        def runs() -> bool:
            # The nodes are announced before the first step; commands are obeyed from that step on.
            said = control("state", *monitor)[1]
            return "nodes 0 1 2 3" in said and ": 0 steps done" not in said

        assert holds_within(30, runs)
        assert control("pause", *operator) == (0, "accepted\n")
        code, said = control("resume", *monitor)
        assert code == 2 and "may these keys not?" in said
        assert "paused; nodes 0 1 2 3" in control("state", *monitor)[1]
        code, said = control("state")
        assert code == 2 and "give --keys" in said
        assert "no such file" in control("state", "--keys", "none.json")[1]
        frames = LiveNetwork([endpoint], None, str(keys / "monitor.json"))
        assert frames.stage.setup.scenario.nodes == 4
        frames.close()


@pytest.mark.slow
@needs_proc
@pytest.mark.zenoh
def test_a_node_that_is_started_again_joins_by_itself(tmp_path: Path):
    setup = write_setup(tmp_path, steps=100_000)
    with hosts(tmp_path) as there:
        endpoint, _ = two_routers(there)
        there.concord("node", setup, 0, 1, 2, "--connect", endpoint)
        lonely = there.concord("node", setup, 3, "--connect", endpoint)
        there.concord("environment", setup, "--connect", endpoint, "--out", tmp_path / "run")
        client = await_network(endpoint)
        try:
            assert holds_within(30, lambda: client.state()["completed"] > 5)
            lonely.kill_all()
            assert holds_within(10, lambda: client.state()["members"] == [0, 1, 2])
            there.concord("node", setup, 3, "--connect", endpoint)
            assert holds_within(20, lambda: client.state()["members"] == [0, 1, 2, 3])
            now = client.state()["completed"]
            assert holds_within(10, lambda: client.state()["completed"] > now + 5)
        finally:
            client.close()


@needs_proc
@pytest.mark.zenoh
def test_a_node_with_another_setup_ends_the_run_and_is_named(tmp_path: Path):
    setup = write_setup(tmp_path)
    other = tmp_path / "other.json"
    other.write_text(setup.read_text().replace('"seed": 1', '"seed": 2'))
    assert read_description_file(other).setup != read_description_file(setup).setup
    with hosts(tmp_path) as there:
        endpoint, _ = two_routers(there)
        there.concord("node", setup, 0, 1, 2, "--connect", endpoint)
        there.concord("node", other, 3, "--connect", endpoint)
        environment = there.concord(
            "environment", setup, "--connect", endpoint, "--out", tmp_path / "run"
        )
        code, _, err = environment.end(40)
    assert code == 1
    assert "node 3 runs configuration" in err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["node", "{setup}", "--connect", "tcp/127.0.0.1:1"], "nodes"),
        (["node", "{setup}", "4", "--connect", "tcp/127.0.0.1:1"], "has nodes 0 to 3"),
        (["node", "{setup}", "1", "1", "--connect", "tcp/127.0.0.1:1"], "named twice"),
        (["node", "{setup}", "1"], "--connect: there is no endpoint"),
        (["node", "{setup}", "1", "--connect", "here:1"], "--connect here:1: not an endpoint"),
        (["node", "{setup}", "1", "--connect", "tls/a:1"], "give --keys"),
        (["node", "{setup}.no", "1", "--connect", "tcp/a:1"], "cannot be read"),
        (
            ["node", "{setup}", "1", "--connect", "tls/a:1", "--keys", "."],
            "--keys node-1.json: no such file; node 1 needs it",
        ),
        (["node", "{setup}", "1", "--connect", "tcp/a:1", "--keys", "."], "over TLS"),
        (
            ["node", "{setup}", "1", "--connect", "tcp/a:1", "--peer-timeout", "0"],
            "--peer-timeout 0",
        ),
        (["environment", "{setup}", "--connect", "tcp/a:99999"], "1 to 65535"),
        (["environment", "{setup}", "--connect", "tls/a:1", "--keys", "."], "recorder.json"),
        (["router", "--listen", "tcp/*:1"], "--listen tcp/*:1: not an endpoint"),
        (["router", "--listen", "tls/a:1", "--keys", "none.json"], "--keys none.json: no such"),
        (["setup", "--out", "{setup}"], "cannot be written"),
        (["setup", "--out", "x", "--name", "a/b"], "run 'a/b'"),
        (["setup", "--out", "x", "--cycle-stretch", "2"], "--cycle-stretch 2"),
        (["setup", "--out", "x", "--changes", "3 kill 1"], "leave kill and restart out"),
    ],
)
def test_what_cannot_be_is_refused(
    words: list[str],
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    setup = write_setup(tmp_path)
    monkeypatch.chdir(tmp_path)
    said = concord(capsys, *(word.format(setup=setup) for word in words))
    assert said.code == 2 and named in said.err


def test_names_that_could_be_patterns_are_refused():
    for run in ("*", "a/*", "", "a b", "-a", "x" * 101):
        with pytest.raises(ValueError, match="a name has"):
            checked_run(run)
    assert checked_run("target-tracking-20260101-1.b_c") == "target-tracking-20260101-1.b_c"
    good = ("tcp/10.0.0.1:7447", "tcp/alpha.example.org:1", "tcp/[::1]:65535")
    assert checked_endpoints("--connect", good, False) == good
