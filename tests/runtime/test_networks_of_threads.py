"""Whole networks of processes, played by threads: equal bits, changes, commands and real time."""

from collections import Counter
from functools import partial
from pathlib import Path

import pytest

from concord.nodes.changes import Event, Joined, Left
from concord.nodes.commands import Kill, Restart, Resume, Step
from concord.nodes.messages import Estimate, Measured, Timing, Truth, decode
from concord.nodes.tempo import Tempo
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.runtime.network import control_client
from concord.runtime.network.control_client import Client, NotThere
from concord.runtime.network.zenoh_transport import LinkError
from concord.runtime.processes.job import Job
from concord.runtime.recording import read_recording, recorded_origin
from concord.scenarios.setup import Setup
from concord.studies.agree import first_difference
from tests.experiments.support import small
from tests.runtime.networks_of_threads import Hub, NetworkOfThreads, Wire

LOCKSTEP = {
    "a hybrid bus, nodes that end and return, other rounds": small(
        nodes=4, steps=12, graph="ring", schedule="hybrid", occupancy=0.5,
        changes=("3 kill 2", "6 restart 2", "8 set rounds=2", "9 loss 0.2"),
    ),
    "links that come and go": small(
        nodes=5, steps=12, graph="ring", rule="ci", weights="equal-neighbour",
        changes=("3 set graph=edges:0-1;1-2;2-3;3-4;0-4;0-3", "6 set graph=path", "8 cut 1 2"),
    ),
    "frames that are late, twice and in another order": small(
        nodes=4, steps=10, changes=("2 delay 0.3 2", "3 duplicate 0.3", "4 reorder 0.5"),
    ),
}  # fmt: skip


def job_of(setup: Setup, folder: Path, **how: object) -> Job:
    return Job(setup, "threads", str(folder / "run.mcap"), None, **how)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", LOCKSTEP)
def test_processes_in_lockstep_give_the_messages_of_one_process(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The order of messages of different processes is left to chance; nothing else is."""
    setup = LOCKSTEP[name]
    network = NetworkOfThreads(job_of(setup, tmp_path), monkeypatch)
    network.run()
    file = tmp_path / "run.mcap"
    # Only processes need to be told that another one is gone.
    expected = in_memory(setup)
    found = [one for one in read_recording(file) if not one[0].startswith("gone")]
    assert Counter(found) == Counter(expected)
    for topic in {topic for topic, _ in expected}:
        of_topic = [[data for name, data in some if name == topic] for some in (found, expected)]
        assert of_topic[0] == of_topic[1], topic
    reference = read_trace(setup, expected)
    assert first_difference(reference, read_trace(setup, found), "threads") is None
    assert recorded_origin(file)["run"] == "threads"


def test_a_client_steers_a_network_that_begins_paused_and_hears_what_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A node that is killed and restarted in between comes back in a later life."""
    steps = 60
    setup = small(nodes=4, steps=steps, graph="ring")
    network = NetworkOfThreads(job_of(setup, tmp_path, begins_paused=True), monkeypatch)
    commands = [(0, Step(2)), (2, Kill(1)), (2, Step(2)), (4, Restart(1))]
    seen: list[tuple[int, int]] = []
    heard: list[tuple[str, bytes]] = []
    clients: list[Client] = []

    def steer(network: NetworkOfThreads) -> bool:
        if not any(one.what == "ready" for one in network.happened):
            return False
        if not clients:
            client = Client(["anywhere"])
            assert client.run == "threads" and client.events() == []
            client.listen("estimate/*", lambda name, data: heard.append((name, data)))
            assert not client.command(Kill(9)).accepted
            clients.append(client)
        (client,) = clients
        state = client.state()
        seen.append((state["completed"], state["released"]))
        if state["paused"] and commands and state["completed"] == commands[0][0]:
            assert client.command(commands.pop(0)[1]).accepted
        elif not commands and state["completed"] == state["released"]:
            # A node that starts again takes part from a step on that begins later.
            is_back = 1 in state["members"]
            if is_back:
                handed = client.handover()
                assert handed is not None and handed.step.number < state["completed"]
                assert handed.events and handed.readings is not None
                assert client.events()[: len(handed.events)] == handed.events
            assert client.command(Resume() if is_back else Step(1)).accepted
            if is_back:
                client.close()
            return is_back
        return False

    network.run(steer)
    assert max(released for completed, released in seen if completed < 2) <= 2
    told = [(one.what, one.node, one.life) for one in network.orders]
    assert told == [("tolerate", 0, 0), ("kill", 1, 0), ("start", 1, 1)]
    assert [one.step for one in network.happened if one.what == "step"][-1] == steps
    recorded = list(read_recording(tmp_path / "run.mcap"))
    said = [decode(*one) for one in recorded if one[0] == "event"]
    events = [(one.change, one.step) for one in said if isinstance(one, Event)]
    [left] = [step for change, step in events if isinstance(change, Left)]
    [joined] = [step for change, step in events if isinstance(change, Joined)]
    assert left == 2 and joined >= 4
    estimates = [decode(*one) for one in recorded if one[0] == "estimate/1"]
    own = [one.step for one in estimates if isinstance(one, Estimate)]
    assert own == [0, 1, *range(joined, steps)]
    every = [one for one in recorded if one[0].startswith("estimate/")]
    assert heard and heard == every[: len(heard)]


def test_where_nobody_answers_a_client_says_so(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(control_client, "_CONNECT_S", 0.05)
    monkeypatch.setattr(control_client, "_HANDOVER_S", 0.05)
    hub = Hub()
    monkeypatch.setattr(control_client, "Transport", partial(Wire, hub))
    with pytest.raises(NotThere, match="at tcp/a:1, tcp/b:2; has the run ended"):
        Client(["tcp/a:1", "tcp/b:2"])
    assert not hub.transports
    client = Client(["tcp/a:1"], "known", "one.key")
    with pytest.raises(NotThere, match="may these keys not"):
        client.state()
    assert client.handover() is None and client.events() == []
    client.close()

    def refuse(*_: object) -> Wire:
        raise LinkError("no link")

    monkeypatch.setattr(control_client, "Transport", refuse)
    with pytest.raises(NotThere, match="no network answers at tcp/a:1"):
        Client(["tcp/a:1"], "known")


# Slow enough for a machine that does much beside.
TEMPO = Tempo(1.0, 0.1, 0.3)


def test_a_network_in_real_time_has_the_readings_of_lockstep_and_tells_its_delays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """No estimate is younger than the cycles of its step."""
    setup = small(nodes=3, steps=8, rounds=2, rule="ci", changes=("2 kill 1", "4 restart 1"))
    network = NetworkOfThreads(job_of(setup, tmp_path, tempo=TEMPO), monkeypatch)
    network.run()
    recorded = list(read_recording(tmp_path / "run.mcap"))
    told = [decode(topic, data) for topic, data in recorded if not topic.startswith("share/")]
    expected = [decode(*one) for one in in_memory(setup) if one[0].startswith(("truth", "mea"))]
    truths = [one for one in told if isinstance(one, Truth)]
    assert truths == [one for one in expected if isinstance(one, Truth)]
    readings = {(one.node, one.step): one.readings for one in expected if isinstance(one, Measured)}
    heard = [one for one in told if isinstance(one, Measured)]
    assert heard and all(one.readings == readings[one.node, one.step] for one in heard)
    timings = {(one.node, one.step): one for one in told if isinstance(one, Timing)}
    for timing in timings.values():
        assert len(timing.cycle_late_s) == 2 and min(timing.cycle_late_s) >= 0
        assert timing.heartbeat_late_s is None or timing.heartbeat_late_s >= 0
    estimates = [one for one in told if isinstance(one, Estimate)]
    assert estimates and {(one.node, one.step) for one in estimates} <= timings.keys()
    for one in estimates:
        assert one.age_s is not None
        assert one.age_s >= 2 * TEMPO.cycle_s
