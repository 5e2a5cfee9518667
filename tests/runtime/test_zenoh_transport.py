"""Sessions, barrier and refusal, in fresh processes: a session does not survive a fork."""

import sys
from pathlib import Path

import pytest

from tests.processes import PROC, family

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]

BEGINNING = """
import os, sys, time
from functools import partial
from concord.runtime.network.links import *
from concord.runtime.processes.supervisor import Supervisor
def say(*words):
    os.write(1, (" ".join(map(str, words)) + "\\n").encode())
quiet, _hold = os.pipe()
supervisor = Supervisor()
"""


def said_by(text: str, folder: Path) -> list[str]:
    with family([sys.executable, "-c", BEGINNING + text], folder) as run:
        code, out, err = run.end(30)
        assert code == 0, err
        assert run.gone_within(1)
    return out.splitlines()


# Everyone joins and at once publishes a number; everyone waits for those of its neighbours.
BARRIER = """
from concord.runtime.network.zenoh_transport import Transport
neighbours = {neighbours}
links = plan_links(neighbours, on_loopback(free_ports(names(neighbours))))
def meet(me):
    heard = [str(j) for j in neighbours[me]]
    transport = Transport("barrier", links[str(me)], [f"n/{{j}}" for j in heard], 64)
    transport.join(str(me), heard)
    transport.send(f"n/{{me}}", str(me * 11).encode())
    came = [transport.receive(f"n/{{j}}") for j in heard]
    assert came == [(f"n/{{j}}", str(int(j) * 11).encode()) for j in heard], came
    say(me, "met", len(came))
    # Leaving closes the links: nobody leaves before all have heard.
    time.sleep(0.5)
def stand_in(name):
    transport = Transport("nobody", links[name], [], 8)
    time.sleep(20)
"""
MESH = """
supervisor.start(RECORDER, partial(stand_in, RECORDER))
supervisor.start(ENVIRONMENT, partial(stand_in, ENVIRONMENT))
for me in range(len(neighbours)):
    supervisor.start(str(me), partial(meet, me))
ends = [supervisor.wait(quiet) for _ in neighbours]
say("ended", *sorted(f"{end.name}:{end.code}" for end in ends))
supervisor.stop()
"""


def test_behind_the_barrier_no_first_message_is_lost(tmp_path: Path):
    """A ring with a chord: all publish in the moment in which they are ready."""
    neighbours = [[1, 3], [0, 2, 4], [1, 3], [0, 2, 4], [1, 3]]
    text = BARRIER.format(neighbours=neighbours) + MESH
    said = said_by(text, tmp_path)
    assert sorted(said[:5]) == [f"{i} met {len(heard)}" for i, heard in enumerate(neighbours)]
    assert said[5] == "ended 0:0 1:0 2:0 3:0 4:0"


def test_a_taken_port_is_a_link_error(tmp_path: Path):
    text = """
import socket
from concord.runtime.network.zenoh_transport import LinkError, Transport, start_router
taken = socket.socket()
taken.bind(("127.0.0.1", 0))
taken.listen()
endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
for attempt in (
    lambda: Transport("x", ZenohEndpoints("peer", (endpoint,), ()), [], 8),
    lambda: start_router(endpoint),
):
    try:
        attempt()
    except LinkError as error:
        say(endpoint in str(error))
os._exit(0)
"""
    assert said_by(text, tmp_path) == ["True", "True"]


def test_idle_connections_keep_no_member_out(tmp_path: Path):
    """By default zenoh lets nobody in beside 100 that say nothing, until it drops them."""
    text = """
import socket
from concord.runtime.network.zenoh_transport import Transport, start_router
with socket.socket() as probe:
    probe.bind(("127.0.0.1", 0))
    port = probe.getsockname()[1]
endpoint = f"tcp/127.0.0.1:{port}"
router = start_router(endpoint)
idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(300)]
Transport("x", ZenohEndpoints("client", (), (endpoint,), 60.0), [], 8)
def is_open(connection):
    connection.setblocking(False)
    try:
        return bool(connection.recv(1))
    except BlockingIOError:
        return True
say("open", is_open(idle[0]))
os._exit(0)
"""
    assert said_by(text, tmp_path) == ["open True"]


def test_the_world_refuses_a_node_with_another_configuration(tmp_path: Path):
    text = """
import signal
from pathlib import Path
from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.runtime.processes.node.process import run_node
from concord.runtime.processes.recorder.process import run_recorder
from concord.runtime.processes.environment.pacing import Lockstep
from concord.runtime.processes.environment.process import run_environment
from concord.runtime.recording import McapRecorder
from concord.runtime.processes.environment.process import Management
from concord.runtime.processes.node.lockstep import LockstepNode
from concord.runtime.processes.node.membership import Membership
from concord.runtime.whole_steps import WholeSteps
from concord.scenarios.build import build_node, build_environment
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
import msgspec
defaults = definition_named("oscillator").defaults
setup = prepare(defaults.with_(nodes=2, graph="path", steps=3))
links = plan_links(setup.neighbours, on_loopback(free_ports(names(setup.neighbours))))
def record():
    recorder = McapRecorder(Path("run.mcap"), 3, 0.1, SHARE_FRAMES)
    run_recorder("refuse", links[RECORDER], links[WATCH], recorder, WholeSteps(2, 3, SHARE_FRAMES))
def node(i, mark):
    membership = Membership("refuse", links[str(i)], build_node(setup, i), mark)
    run_node(membership, LockstepNode(membership))
supervisor.start(RECORDER, record)
supervisor.start("0", partial(node, 0, 64 * "a"))
supervisor.start("1", partial(node, 1, 64 * "b"))
management = Management(None, None, None, lambda step: None, b"{}", os.pipe()[0])
config = build_environment(setup)
link = links[ENVIRONMENT]
environment = partial(run_environment, "refuse", link, config, 64 * "a", management, Lockstep())
supervisor.start(ENVIRONMENT, environment)
say(*supervisor.wait(quiet))
supervisor.stop()
"""
    with family([sys.executable, "-c", BEGINNING + text], tmp_path) as run:
        code, out, err = run.end(30)
    assert (code, out) == (0, "environment 1\n")
    assert "node 1 runs configuration 'bbbbbbbbbbbb', the environment 'aaaaaaaaaaaa'" in err


# The talker sends more messages on one topic than its queue takes, then one on another topic. The
# queue has a node's size: the overflow empties it at most once in 50 ms, and zenoh sends no
# keep-alive while a full queue blocks its thread. With 16 places the link's lease of 2 s ran out.
FULL_QUEUE = """
from concord.runtime.processes.overflow import Overflow
from concord.runtime.processes.node.lockstep_inbox import NODE_QUEUE
from concord.runtime.network.zenoh_transport import Transport
links = plan_links([[1], [0]], on_loopback(free_ports(names([[1], [0]]))))
def talk():
    transport = Transport("full", links["0"]._replace(connect=()), [], 8)
    transport.join("0", ["1"])
    for number in range(4 * NODE_QUEUE):
        transport.send("many", str(number).encode())
    transport.send("one", b"at last")
    time.sleep(20)
def listen():
    port = links["0"].listen[0]
    transport = Transport("full", links["1"]._replace(connect=(port,)), ["many", "one"], NODE_QUEUE)
    queues = Overflow(transport, ["many", "one"], NODE_QUEUE)
    queues.out = False
    transport.join("1", ["0"])
    kept = []
    while not any(topic == "one" for topic, data in kept):
        kept += queues.receive(["one"]) or queues.take()
    # The overflow's thread may have taken messages aside while "one" came in.
    queues.close()
    kept += queues.take()
    while (received := transport.receive_at_once("many")) is not None:
        kept.append(received)
    numbers = [int(data) for topic, data in kept if topic == "many"]
    say(numbers == list(range(4 * NODE_QUEUE)))
supervisor.start("talks", talk)
supervisor.start("listens", listen)
supervisor.wait(quiet)
supervisor.stop()
"""


def test_a_full_queue_hides_nothing_that_is_waited_for(tmp_path: Path):
    """All messages come in through one thread, which waits where a queue is full."""
    assert said_by(FULL_QUEUE, tmp_path) == ["True"]


HUGE = """
from concord.runtime.network.zenoh_transport import Transport
port = f"tcp/127.0.0.1:{free_ports(['huge'])['huge']}"
def talk():
    transport = Transport("huge", ZenohEndpoints("peer", (), (port,), 10.0), [], 8)
    transport.join("talks", ["listens"])
    for size in (1, 1 << 20, 70_000_000, 2):
        transport.send("many", bytes(size))
    time.sleep(20)
def listen():
    transport = Transport("huge", ZenohEndpoints("peer", (port,), ()), ["many"], 8)
    transport.join("listens", ["talks"])
    say(*(len(transport.receive("many")[1]) for _ in range(3)))
supervisor.start("talks", talk)
supervisor.start("listens", listen)
supervisor.wait(quiet)
supervisor.stop()
"""


def test_what_is_too_much_for_any_memory_is_not_put_together(tmp_path: Path):
    """The link stays, and the next message comes."""
    assert said_by(HUGE, tmp_path) == [f"1 {1 << 20} 2"]


# A thread may still look for messages when its process ends, and with it the session.
LEAVING = """
from concord.runtime.network.zenoh_transport import Transport
def leave():
    endpoint = f"tcp/127.0.0.1:{free_ports(['own'])['own']}"
    transport = Transport("leaving", ZenohEndpoints("peer", (endpoint,), (), 5.0), ["many"], 8)
    transport.close()
    say("heard", transport.receive_at_once("many"))
    transport.wake("many")
supervisor.start("own", leave)
say(supervisor.wait(quiet).code)
"""


def test_who_has_left_hears_nothing(tmp_path: Path):
    assert said_by(LEAVING, tmp_path) == ["heard None", "0"]


# A recorder takes together what has come, and must know what came before it was woken up.
TOGETHER = """
from concord.runtime.network.zenoh_transport import Transport
def take():
    endpoint = f"tcp/127.0.0.1:{free_ports(['own'])['own']}"
    transport = Transport("together", ZenohEndpoints("peer", (endpoint,), (), 5.0), ["many/*"], 8)
    for number in range(3):
        transport.send(f"many/{number}", str(number).encode())
    transport.wake("many/*")
    transport.send("many/3", b"3")
    for _ in range(2):
        received, is_woken = transport.receive_all("many/*")
        say(*(f"{topic}={data.decode()}" for topic, data in received), is_woken)
    heard = []
    transport.listened("watch/**", heard.append)
    stop = transport.listen("watch/steps", print)
    while heard != [True]:
        time.sleep(0.01)
    stop()
    while heard != [True, False]:
        time.sleep(0.01)
    say("heard", *heard)
supervisor.start("own", take)
supervisor.wait(quiet)
supervisor.stop()
"""


def test_what_is_taken_together_is_in_order_and_none_came_after_a_call(tmp_path: Path):
    together = ["many/0=0 many/1=1 many/2=2 True", "many/3=3 False"]
    assert said_by(TOGETHER, tmp_path) == [*together, "heard True False"]
