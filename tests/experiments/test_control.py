"""Commands to a network of real processes: what they do, what is refused, what remains."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest

from concord.experiments.__main__ import main
from concord.nodes.commands import Answer, in_words
from concord.nodes.messages import decode
from concord.runtime.network.control_client import Client, NotThere
from concord.runtime.network.network_file import read_network
from tests.experiments.support import small, trace_of
from tests.laboratory.running import Running
from tests.processes import PATIENCE_S, PROC, holds_within, lives

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]


class Controlled(Running):
    """A network that a test commands."""

    def say(self, words: str) -> Answer:
        return self.client.command(in_words(words.split()))

    def holds(self, condition: Callable[[dict], bool], seconds: float = PATIENCE_S) -> bool:
        return holds_within(seconds, lambda: condition(self.client.state()))

    def goes_on(self) -> bool:
        """Ten steps more, done by all."""
        now = self.client.state()["completed"]
        return self.holds(lambda state: state["completed"] > now + 10)


@contextmanager
def running(folder: Path, **changes) -> Iterator[Controlled]:
    """A network that is let go to its end, whatever happens."""
    setup = small(**{"nodes": 5, "graph": "ring", "steps": 100_000, **changes})
    network = Controlled(setup, "controlled", folder)
    try:
        yield network
    finally:
        network.client.close()
        if (environment := network.pids.get("environment")) and lives(environment):
            os.kill(environment, signal.SIGKILL)
        assert network.ended_within(60)
        assert holds_within(PATIENCE_S, lambda: not any(map(lives, network.pids.values())))


def test_pause_step_speed(tmp_path: Path):
    with running(tmp_path) as network:
        assert network.say("step 3") == Answer(False, "step 3: the network runs; pause it first")
        assert network.say("pause").accepted
        assert network.holds(lambda state: state["completed"] == state["released"])
        still = network.client.state()["completed"]
        time.sleep(0.2)
        assert network.client.state()["completed"] == still
        assert network.say("step 7").accepted
        assert network.holds(lambda state: state["completed"] == still + 7)
        time.sleep(0.1)
        assert network.client.state()["completed"] == still + 7
        assert network.say("speed 20").accepted
        assert network.say("resume").accepted
        began, first = time.monotonic(), network.client.state()["completed"]
        assert network.holds(lambda state: state["completed"] >= first + 20)
        rate = (network.client.state()["completed"] - first) / (time.monotonic() - began)
        # A busy machine may do fewer steps a second, but never more.
        assert rate < 25
        assert network.say("speed 0").accepted
        assert network.goes_on()


def test_kill_restart_cut_and_set_are_obeyed_and_told(tmp_path: Path):
    with running(tmp_path) as network:
        events: list[bytes] = []
        network.client.listen("event", lambda topic, data: events.append(data))
        pid = network.pids["3"]
        assert network.say("kill 3").accepted
        assert holds_within(PATIENCE_S, lambda: not lives(pid))
        assert network.client.state()["members"] == [0, 1, 2, 4]
        assert network.goes_on()
        assert network.say("restart 3").accepted
        assert network.holds(lambda state: state["members"] == [0, 1, 2, 3, 4])
        assert lives(network.pids["3"])
        for words in ("cut 1 2", "loss 0.1", "set rule=hcmci rounds=2 occupancy=0.5"):
            assert network.say(words).accepted
        assert network.goes_on()
        standing = network.client.state()["standing"]
        assert standing["cuts"] == [[1, 2], [2, 1]]
        assert standing["settings"]["schedule"] == "dynamic"
        kinds = [decode("event", data).change for data in events]
        named = [type(change).__name__ for change in kinds]
        assert named == ["Left", "Joined", "Cut", "Cut", "Loss", "Set"]
    trace = trace_of(network.setup, tmp_path / "run.mcap")
    out = np.isnan(trace.mean[:, 3, 0])
    assert out.sum() > 10
    assert not out[-5:].any()
    assert not np.isnan(trace.mean[:, [0, 1, 2, 4]]).any()


REFUSED = {
    "kill 9": "there are nodes 0 to 4",
    "restart 1": "the node is not out",
    "cut 0 2": "node 2 does not hear node 0",
    "loss 1.5": "at least 0 and below 1",
    "speed -1": "0.001 to 1000",
    "speed 1e-300": "0.001 to 1000",
    "set rule=hcmcx": "did you mean 'hcmci'",
    "set rounds=0": "at least 1",
    "set rounds=x": "rounds",
    "set steps=7": "unknown setting 'steps'",
    "set rule=ellipsoid": "bound",
}


def test_what_cannot_be_is_refused_with_the_reason_and_nothing_happens(tmp_path: Path):
    with running(tmp_path) as network:
        for words, reason in REFUSED.items():
            answer = network.say(words)
            assert not answer.accepted
            assert reason in answer.detail, answer
        ask = network.client._transport.ask
        for payload in (b"", b"{", b"[]", b'{"do": "fly"}', b'{"do": "kill"}', b"x" * 5000):
            told = ask("control", payload)
            assert told is not None
            assert not msgspec.json.decode(told, type=Answer).accepted
        assert network.goes_on()
        assert network.client.state()["members"] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("graph", ["ring", "complete"])
def test_a_process_that_is_killed_by_nobody_in_particular_stops_no_one(tmp_path: Path, graph: str):
    """Through a mesh, and through a router; the node is back on command."""
    nodes = 5 if graph == "ring" else 11
    with running(tmp_path, nodes=nodes, graph=graph) as network:
        os.kill(network.pids["2"], signal.SIGKILL)
        assert network.holds(lambda state: 2 not in state["members"])
        assert network.goes_on()
        assert network.say("restart 2").accepted
        assert network.holds(lambda state: 2 in state["members"])
        assert network.goes_on()


def test_the_command_line_controls_a_network(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with running(tmp_path) as network:
        main(["control", str(tmp_path), "pause"])
        assert capsys.readouterr().out == "accepted\n"
        main(["control", str(tmp_path), "state", "--json"])
        assert msgspec.json.decode(capsys.readouterr().out)["paused"]
        with pytest.raises(SystemExit) as left:
            main(["control", str(tmp_path), "kill", "17"])
        assert left.value.code == 2
        assert "kill 17: there are nodes 0 to 4" in capsys.readouterr().err
        network.say("resume")


def test_nobody_answers_for_a_network_that_has_ended(tmp_path: Path):
    with running(tmp_path, steps=200) as network:
        assert network.ended_within(60)
        with pytest.raises(NotThere, match="has the run ended"):
            Client(read_network(tmp_path).connect)
