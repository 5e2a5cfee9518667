"""Links that break while messages are under way: whatever is lost is said again, or it is told."""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest

from concord.runtime.network.links import ENVIRONMENT, RECORDER, free_ports, names
from concord.runtime.recording import read_recording
from concord.scenarios.setup import Setup
from concord.studies.agree import first_difference
from tests.experiments.support import reference, small, trace_of
from tests.processes import PROC, Family, family
from tests.relay import Relay

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]

NETWORK = """
import os, sys
from concord.bus.flexray.share_frames import SHARE_FRAMES
from functools import partial
from pathlib import Path
import msgspec
from concord.runtime.network.links import *
from concord.runtime.processes.environment.process import Management
from concord.runtime.processes.node.lockstep import LockstepNode
from concord.runtime.processes.node.membership import Membership
from concord.runtime.processes.node.process import run_node
from concord.runtime.processes.recorder.process import run_recorder
from concord.runtime.recording import McapRecorder
from concord.runtime.processes.supervisor import Supervisor
from concord.runtime.whole_steps import WholeSteps
from concord.runtime.processes.environment.pacing import Lockstep
from concord.runtime.processes.environment.process import run_environment
from concord.scenarios.build import build_node, build_environment
from concord.scenarios.preparation import fingerprint
from concord.scenarios.setup import Setup
setup = msgspec.json.decode(Path("setup.json").read_bytes(), type=Setup)
mark, count = fingerprint(setup), setup.scenario.nodes
links = plan_links(setup.neighbours, on_loopback({ports}))
one, old, new = {detour}
links[one] = links[one]._replace(connect=tuple(new if c == old else c for c in links[one].connect))
supervisor, (quiet, hold) = Supervisor(), os.pipe()
def tell(step):
    os.write(1, f"{{step}}\\n".encode())
def record():
    rounds, step_s = setup.scenario.rounds, setup.time_step_s
    recorder = McapRecorder(Path("run.mcap"), rounds, step_s, SHARE_FRAMES)
    steps = WholeSteps(count, 3, SHARE_FRAMES)
    run_recorder("broken", links[RECORDER], links[WATCH], recorder, steps)
def be(i):
    membership = Membership("broken", links[str(i)], build_node(setup, i), mark)
    run_node(membership, LockstepNode(membership))
supervisor.start(RECORDER, record)
management = Management(None, None, None, tell, b"{{}}", os.pipe()[0])
config = build_environment(setup)
environment = partial(
    run_environment, "broken", links[ENVIRONMENT], config, mark, management, Lockstep()
)
supervisor.start(ENVIRONMENT, environment)
for i in range(count):
    supervisor.start(str(i), partial(be, i))
for name, pid in supervisor.pids.items():
    os.write(1, f"{{name}} {{pid}}\\n".encode())
while (ended := supervisor.wait(quiet)).name != RECORDER:
    if ended.code:
        sys.stderr.write(f"{{ended.name}} ended with {{ended.code}}\\n")
supervisor.stop(1.0)
sys.exit(ended.code)
"""


@contextmanager
def network(
    setup: Setup, folder: Path, one: str, other: str, before: str = ""
) -> Iterator[tuple[Family, Relay]]:
    """A network in which the link from one process to another goes through a relay."""
    (folder / "setup.json").write_bytes(msgspec.json.encode(setup))
    ports = free_ports(names(setup.neighbours))
    relay = Relay(ports[other])
    detour = (one, f"tcp/127.0.0.1:{ports[other]}", f"tcp/127.0.0.1:{relay.port}")
    script = before + NETWORK.format(ports=ports, detour=detour)
    try:
        with family([sys.executable, "-c", script], folder) as run:
            yield run, relay
    finally:
        relay.close()


def await_pid(run: Family, name: str) -> int:
    """Return the number of a process, from the first output of the network."""
    return int(run.await_output(lambda line: line.startswith(f"{name} ")).split()[1])


def await_step(run: Family, step: int) -> None:
    """Until the network has completed a step."""
    run.await_output(lambda line: line.strip().isdecimal() and int(line) >= step)


@pytest.mark.parametrize(("one", "other"), [("2", "1"), ("2", RECORDER), (ENVIRONMENT, RECORDER)])
def test_what_a_broken_link_has_lost_is_said_again(tmp_path: Path, one: str, other: str):
    """Three times what is under way on a link is lost with it."""
    setup = small(steps=600)
    with network(setup, tmp_path, one, other) as (run, relay):
        for step in (100, 250, 400):
            await_step(run, step)
            relay.lose()
            time.sleep(0.02)
            relay.cut()
        code, _, err = run.end(30)
        assert (code, err) == (0, "")
        assert relay.lost > 0
        assert run.gone_within(1)
    said = list(read_recording(tmp_path / "run.mcap"))
    assert len(said) == len(set(said))
    file = tmp_path / "reference.mcap"
    trace = trace_of(setup, tmp_path / "run.mcap")
    assert first_difference(reference(setup, tmp_path), trace, "broken") is None
    assert sorted(said) == sorted(read_recording(file))


def test_a_node_that_loses_the_world_is_let_in_again(tmp_path: Path):
    """The network counts the node as dead; then its link comes back."""
    setup = small(steps=600)
    with network(setup, tmp_path, "2", ENVIRONMENT) as (run, relay):
        await_step(run, 100)
        relay.lose()
        time.sleep(0.02)
        relay.cut()
        code, _, err = run.end(30)
        gone, back = err.splitlines()
        assert code == 0 and gone.startswith("environment: node 2 is gone from step")
        assert back.startswith("environment: node 2 is back from step")
    trace = trace_of(setup, tmp_path / "run.mcap")
    finite = np.isfinite(trace.mean[:, :, 0])
    assert finite[:, [0, 1, 3]].all()
    assert not finite[:, 2].all() and finite[-1, 2]


def test_a_link_between_nodes_that_stays_away_ends_the_wait(tmp_path: Path):
    """One of both is given up after the grace, and the others go on to the end."""
    setup = small(steps=300)
    with network(setup, tmp_path, "2", "1") as (run, relay):
        await_step(run, 100)
        relay.lose()
        relay.cut(for_good=True)
        await_step(run, 300)
        events = [data for topic, data in read_recording(tmp_path / "run.mcap") if topic == "event"]
        assert any(b'"gone"' in data.lower() for data in events)


SHORT = """
import concord.runtime.processes.republisher, concord.runtime.processes.environment.process
concord.runtime.processes.republisher._AGAIN_S = concord.runtime.processes.republisher._TELL_S = 0.5
concord.runtime.processes.environment.process._PEER_TIMEOUT_S = 3.0
"""


def test_a_recorder_that_stays_away_is_named_and_ends_the_run(tmp_path: Path):
    """Processes hold messages back, report the wait, and end the run after the peer timeout."""
    setup = small(steps=4000)
    with network(setup, tmp_path, ENVIRONMENT, RECORDER, SHORT) as (run, relay):
        await_step(run, 50)
        relay.lose()
        relay.cut(for_good=True)
        run.await_line("the environment has waited 1 s for the recorder, which is out of reach", 20)
        run.await_line("the recorder has been out of reach for 3 s", 20)
        run.await_line("environment ended with 1", 20)
        # On a busy machine the recorder is some steps behind.
    assert trace_of(setup, tmp_path / "run.mcap").steps > 0


def test_a_node_that_stands_still_is_named(tmp_path: Path):
    """Within its lease the node is not dead: waiting processes name it until it goes on."""
    setup = small(steps=600)
    with network(setup, tmp_path, "2", "1", SHORT) as (run, _):
        pid = await_pid(run, "3")
        await_step(run, 50)
        os.kill(pid, signal.SIGSTOP)
        run.await_line("the environment has waited 1 s for the estimates of step", 10)
        os.kill(pid, signal.SIGCONT)
        code, _, _ = run.end(30)
        assert code == 0
    trace = trace_of(setup, tmp_path / "run.mcap")
    assert first_difference(reference(setup, tmp_path), trace, "stopped") is None


@pytest.mark.parametrize("victim", ["2", RECORDER, ENVIRONMENT])
def test_who_was_stopped_for_longer_than_the_lease_stops_nobody_for_ever(
    tmp_path: Path, victim: str
):
    setup = small(steps=600)
    with network(setup, tmp_path, "2", "1") as (run, _):
        pid = await_pid(run, victim)
        await_step(run, 100)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(4)
        os.kill(pid, signal.SIGCONT)
        code, _, err = run.end(30)
        assert code == 0, err
    assert trace_of(setup, tmp_path / "run.mcap").steps == 600
