"""What the processes of a network do: each is a loop around its state machine.

Lockstep is schedule-driven: a node always knows which message it needs next (its heartbeat, a
grant, the share of one neighbour) and waits for that one alone. Nobody coordinates, nothing is
timed.
"""

from collections.abc import Callable, Collection

from nodes import state_machine, world
from nodes.links import RECORDER, WORLD, Links
from nodes.messages import ShareHeard, decode, encode, topic
from nodes.recording import Recorder
from nodes.state_machine import NodeConfig, Phase
from nodes.world import WorldConfig
from nodes.zenoh_transport import Transport

NODE_QUEUE, WORLD_QUEUE, RECORDER_QUEUE = 1024, 16_384, 65_536


def run_node(
    run: str, links: Links, config: NodeConfig, peers: Collection[int], fingerprint: str
) -> None:
    """Be one node until the recorder says that the run is over.

    `peers` are those whom it hears or who hear it: all must be there before the first share.

    Raises:
        LinkError: the network cannot be joined.
    """
    heartbeat, grant = f"measured/{config.index}", "grant"
    shares = {j: f"share/{j}" for j in config.neighbours}
    transport = Transport(run, links, [heartbeat, grant, "end", *shares.values()], NODE_QUEUE)
    transport.join(str(config.index), {WORLD, RECORDER, *map(str, peers)})
    transport.send(f"hello/{config.index}", fingerprint.encode())
    state = state_machine.initial_state(config)
    while state.phase is not Phase.FINISHED:
        match state.phase:
            case Phase.MEASUREMENT:
                event = decode(*transport.receive(heartbeat))
            case Phase.GRANT:
                event = decode(*transport.receive(grant))
            case _:
                sender = state_machine.awaited_neighbour(config, state)
                assert sender is not None, "a node in phase SHARES waits for somebody"
                event = ShareHeard(sender, transport.receive(shares[sender])[1])
        state, messages = state_machine.step(config, state, event)
        for message in messages:
            transport.send(topic(message), encode(message))
    transport.receive("end")
    transport.close()


class Disagreement(Exception):
    """A node was started with another configuration than the world."""


def run_world(
    run: str,
    links: Links,
    config: WorldConfig,
    fingerprint: str,
    on_step: Callable[[int], None],
) -> None:
    """Be the world: wait for all nodes, then run to the last step; `on_step(0)` means ready.

    Raises:
        LinkError: the network cannot be joined.
        Disagreement: a node's configuration is not ours.
    """
    transport = Transport(run, links, ["hello/*", "bid/*", "estimate/*", "end"], WORLD_QUEUE)
    transport.join(WORLD, {RECORDER, *(str(i) for i in range(config.nodes))})
    for _ in range(config.nodes):
        who, theirs = transport.receive("hello/*")
        if theirs.decode(errors="replace") != fingerprint:
            raise Disagreement(f"{who} runs configuration {theirs!r}, the world {fingerprint!r}")
    on_step(0)
    state, messages = world.begin(config)
    while True:
        for message in messages:
            transport.send(topic(message), encode(message))
        if world.finished(config, state):
            break
        completed = state.completed
        source = "bid/*" if world.awaits_bids(config, state) else "estimate/*"
        state, messages = world.step(config, state, decode(*transport.receive(source)))
        if state.completed > completed:
            on_step(state.completed)
    transport.send("finished", b"")
    transport.receive("end")
    transport.close()


def run_recorder(run: str, links: Links, recorder: Recorder, estimates: int) -> None:
    """Record every message until the world has finished and all `estimates` have come.

    Raises:
        LinkError: the network cannot be joined.
    """
    transport = Transport(run, links, ["**"], RECORDER_QUEUE)
    transport.join(RECORDER, set())
    finished, counted = False, 0
    while not finished or counted < estimates:
        name, data = transport.receive("**")
        kind = name.partition("/")[0]
        if kind == "finished":
            finished = True
        elif kind not in ("hello", "end"):
            counted += kind == "estimate"
            recorder.record(name, data)
    recorder.close()
    transport.send("end", b"")
    transport.close()
