"""Malformed messages against a network of real processes, a few thousand of a million."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from concord.nodes.commands import Answer, Speed
from concord.nodes.messages import END, Estimate
from concord.runtime.network.links import ENVIRONMENT, RECORDER, WATCH, names
from concord.runtime.processes.environment.inbox import ENVIRONMENT_QUEUE
from concord.runtime.processes.recorder.process import STRANGE
from concord.runtime.recorded import message_of
from concord.runtime.recording import read_recording
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from tests.laboratory.fuzz import storm_of
from tests.laboratory.running import PROC, Running, neighbouring_ports, oscillators, stranger
from tests.processes import holds_within
from tests.runtime.test_zenoh_transport import said_by

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="reads memory in /proc, which is not there"),
]


def two_nodes(steps: int) -> tuple[Setup, dict[str, int]]:
    """A network of two, and its ports."""
    setup = oscillators(2, "path", steps)
    return setup, neighbouring_ports(names(setup.neighbours))


@contextmanager
def pair(folder: Path) -> Iterator[tuple[Running, dict[str, int]]]:
    """A slow network of two nodes, and its ports; it must end in order."""
    setup, ports = two_nodes(200)
    running = Running(setup, "pair", folder, min(ports.values()))
    running.client.command(Speed(20.0))
    try:
        yield running, ports
    finally:
        running.end()


def test_malformed_messages_are_all_counted_and_change_no_bit():
    """Nodes, environment and recorder each count what was said to them, more than queues hold."""
    outcome = storm_of(9000, seed=3, steps=400)
    assert outcome.refused == outcome.sent
    assert sum(outcome.sent.values()) == 9000
    assert outcome.same_estimates


# Megabytes of a full queue, when no process takes its messages out.
FULL = """
from tests.laboratory.running import memory_mb
from concord.runtime.processes.recorder.process import RECORDER_QUEUE
from concord.runtime.network.zenoh_transport import Transport
port = f"tcp/127.0.0.1:{free_ports(['full'])['full']}"
def talk():
    transport = Transport("full", ZenohEndpoints("peer", (), (port,), 10.0), [], 1)
    transport.join("talks", ["listens"])
    for number in range(RECORDER_QUEUE + 1000):
        transport.send("many", b"m")
    time.sleep(20)
def listen():
    transport = Transport("full", ZenohEndpoints("peer", (port,), ()), ["**"], RECORDER_QUEUE)
    before = memory_mb({"own": os.getpid()})["own"]
    transport.join("listens", ["talks"])
    taken, grown = -1, 0
    while grown != taken:
        time.sleep(1)
        taken, grown = grown, memory_mb({"own": os.getpid()})["own"] - before
    say(grown)
supervisor.start("talks", talk)
supervisor.start("listens", listen)
supervisor.wait(quiet)
supervisor.stop()
"""


@pytest.mark.parametrize(("topic", "data"), [("bid/0", b"no bid"), ("end", END)])
def test_a_flood_that_nobody_waits_for_leaves_the_world_hearing(
    topic: str, data: bytes, tmp_path: Path
):
    """No node contends here, so the environment waits for estimates alone; the end is far."""
    flood = 2 * ENVIRONMENT_QUEUE + 2000
    with pair(tmp_path) as (running, ports):
        intruder = stranger("pair", ports[ENVIRONMENT])
        for _ in range(flood):
            intruder.send(topic, data)
        assert holds_within(20, lambda: running.client.state()["refused"] == flood)
        completed = running.client.state()["completed"]
        assert holds_within(20, lambda: running.client.state()["completed"] > completed)
        intruder.close()


# Too long for Python to make a number of; and of it no JSON can be told either.
LONG = "9" * 5000
DEEP = b"[" * 3000
ENVIRONMENT_HEARS = [
    (f"hello/{LONG}", b"0" * 64),
    ("hello/\u0663", b"0" * 64),
    ("hello/1", b"0" * 64),
    (f"recorded/{LONG}", b"{}"),
    ("recorded/1", b"{}"),
    ("unreachable/9", b'{"node":9,"neighbour":0}'),
    ("estimate/1", b'{"node":1,"x":' + DEEP),
    ("estimate/\u202e\n\u2603", b"{}"),
]
NO_ROUNDS = b'{"step":0,"change":{"what":"settings","settings":{"rounds":%b},"first_cycle":0}}'
RECORDER_HEARS = [
    (f"estimate/{LONG}", b'{"step":0}'),
    ("estimate/\u0663", b'{"step":0}'),
    ("estimate/01", b'{"step":0}'),
    ("estimate/1", b'{"step":0,"x":' + DEEP),
    ("finished", b'{"step":0,"members":[],"x":' + DEEP),
    ("event", NO_ROUNDS % b"0"),
    ("event", NO_ROUNDS % b'"x"'),
    ("event", NO_ROUNDS % b"1e300"),
    ("event", b'{"step":-7,"change":{"what":"left","node":1}}'),
    (f"share/{LONG}", b""),
    ("\x01\u202e\n\u2603", b"{}"),
]


def test_what_strangers_call_themselves_ends_nobody(tmp_path: Path):
    """Names that are no numbers or too long for one, JSON too deep, changes that cannot be."""
    with pair(tmp_path) as (running, ports):
        pids = running.pids
        here = {name: stranger("pair", ports[name]) for name in ports if name != WATCH}
        for name in (LONG, "\u0663", "\u00b2", "01", "\u2603"):
            for intruder in here.values():
                intruder.join(name, {name})
        for topic, data in ENVIRONMENT_HEARS:
            here[ENVIRONMENT].send(topic, data)
        for topic, data in RECORDER_HEARS:
            here[RECORDER].send(topic, data)
        deep = b'{"do":"pause","x":' + DEEP
        answer = msgspec.json.decode(here[ENVIRONMENT].ask("control", deep) or b"", type=Answer)
        assert not answer.accepted and "not a command" in answer.detail
        count = len(ENVIRONMENT_HEARS)
        assert holds_within(20, lambda: running.client.state()["refused"] == count)
        for intruder in here.values():
            intruder.close()
        completed = running.client.state()["completed"]
        assert holds_within(20, lambda: running.client.state()["completed"] > completed + 5)
        assert running.client.state()["members"] == [0, 1]
        assert running.pids == pids


def test_topics_without_end_are_one_in_the_recording(tmp_path: Path):
    """A file has 65535 channels at most, and each topic that a recorder knows takes memory."""
    with pair(tmp_path) as (_, ports):
        intruder = stranger("pair", ports[RECORDER])
        for number in range(1000):
            intruder.send(f"estimate/x{number}", b"{}")
            intruder.send(f"nonsense/{number}", b"{}")
        intruder.close()
    recorded = list(read_recording(tmp_path / "run.mcap"))
    assert len({topic for topic, _ in recorded}) < 20
    assert sum(topic == STRANGE for topic, _ in recorded) == 2000


def test_what_waits_for_the_recorder_takes_little(tmp_path: Path):
    """Messages of one byte, each of which zenoh keeps in the buffer in which it came."""
    (said,) = said_by(FULL, tmp_path)
    assert int(said) <= 100


def test_in_real_time_nobody_is_deaf_for_what_was_said_long_ago(tmp_path: Path):
    """The start is announced once; later messages on its topic must not hold up the run."""
    setup, ports = two_nodes(30)
    running = Running(setup, "pair", tmp_path, min(ports.values()), tempo_of(setup, None))
    intruder = stranger("pair", ports["0"])
    for _ in range(100):
        intruder.send("start", b"no start")
    assert running.ended_within(60) and running.failure is None
    intruder.close()
    told = [
        message_of(topic, data, 2) for topic, data in running.recorded() if topic == "estimate/0"
    ]
    assert isinstance(told[-1], Estimate) and told[-1].step == 29
