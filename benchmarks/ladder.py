"""Where a step of a lockstep network goes: the bare loop built up piece by piece.

Node, environment and recorder are fed from memory, so each rung is processor time without zenoh.
The loop of bytes and the whole network then run as processes. The first gives the price of zenoh
and the system, the second what the rungs do not explain: colder caches, and waits of threads.
"""

import tempfile
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path

from benchmarks.bare_loop import language_of
from benchmarks.lockstep import (
    NODES,
    SHORT_STEPS,
    floor_rate,
    load_of,
    lockstep_rate,
    pace_of,
    setup_of,
    traffic_of,
)
from benchmarks.lockstep import STEPS as NETWORK_STEPS
from benchmarks.measure import BenchmarkFigures, figure, in_turns, median_us, say
from benchmarks.node_loop import (
    NODE,
    STEPS,
    Messages,
    RecordedNetwork,
    bare_node_s,
    node_s,
    recorded_network,
)
from concord.nodes import node as state_machine
from concord.nodes.messages import ShareHeard, decode, encode, topic
from concord.nodes.node_state import Phase
from concord.nodes.run_controller import ProcessStarter, RunController
from concord.runtime.drivers import in_memory
from concord.runtime.recording import McapRecorder
from concord.runtime.whole_steps import WholeSteps
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.setup import Setup

TURNS, NETWORK_TURNS = 5, 3
NODE_RUNGS = ("filters and loop", "codec", "state machine", "inbox and republisher")


def main() -> BenchmarkFigures:
    """Print and return processor time per step of the network, and its parts."""
    setup = setup_of(STEPS)
    messages = in_memory(setup)
    traffic = traffic_of(messages)
    load, load_of_bytes = (load_of(setup, traffic, says) for says in (True, False))
    contestants: dict[str, Callable[[], float]] = {
        "filters and loop": partial(bare_node_s, load_of_bytes, messages, True),
        "codec": partial(bare_node_s, load, messages, True),
        "state machine": partial(_transitions, setup, messages),
        "inbox and republisher": partial(node_s, setup, messages, True),
        "environment, bare": partial(_bare_environment, setup, messages),
        "environment": partial(_environment, setup, messages),
        "recorder": partial(_recorder, setup, messages),
    }
    given = in_turns(contestants, TURNS)
    us = {name: median_us(spent) for name, spent in given.items()}
    network_us = _network_us(setup_of(NETWORK_STEPS), setup_of(SHORT_STEPS))
    rungs = {"filters and loop": NODES * us["filters and loop"]}
    rungs["zenoh, system and wake-ups"] = network_us["bytes"] - rungs["filters and loop"]
    for below, name in pairwise(NODE_RUNGS):
        rungs[name] = NODES * (us[name] - us[below])
    rungs["environment"] = us["environment"]
    rungs["recorder"] = us["recorder"]
    whole = network_us["lockstep"]
    rungs["not explained: colder caches, threads"] = whole - sum(rungs.values())
    say(f"a step of {NODES} nodes in lockstep: {whole / 1e3:.1f} ms of processor, {TURNS} turns")
    below = 0.0
    results: BenchmarkFigures = {"lockstep us": figure([whole], "us/step", "less")}
    for name, spent in rungs.items():
        below += spent
        results[f"{name} us"] = figure([spent], "us/step", "less")
        say(f"  {name:<40}{spent:9.0f} us {spent / whole:6.1%}   up to here {below / whole:6.1%}")
    bare_us = us["environment, bare"]
    say(f"  a loop that only reads and writes what the environment does takes {bare_us:.0f} us")
    return results


def _transitions(setup: Setup, messages: Messages) -> float:
    """Seconds per step of a node's state machine, its messages read and written."""
    config = build_node(setup, NODE)
    memory: RecordedNetwork = recorded_network(setup.neighbours[NODE], messages, True)
    memory.join()
    state = state_machine.initial_state(config)
    while state.phase is not Phase.FINISHED:
        if state.phase is Phase.MEASUREMENT:
            events = [decode(*memory.receive(f"measured/{NODE}"))]
        else:
            senders = state_machine.awaited_neighbours(config, state)
            events = [ShareHeard(one, memory.receive(f"share/{one}")[1]) for one in senders]
        state, sent = state_machine.step(config, state, *events)
        for message in sent:
            memory.send(topic(message), encode(message))
    return memory.spent_s / STEPS


def _estimates(messages: Messages) -> deque[tuple[str, bytes]]:
    return deque(one for one in messages if one[0].startswith("estimate/"))


def _bare_environment(setup: Setup, messages: Messages) -> float:
    """Seconds per step of a loop that reads estimates and writes readings."""
    language = language_of(load_of(setup, traffic_of(messages)))
    estimates = _estimates(messages)
    began_s = time.thread_time()
    for step in range(STEPS):
        for node in range(NODES):
            language.measured(node, step)
            language.hear(*estimates.popleft())
    return (time.thread_time() - began_s) / STEPS


def _environment(setup: Setup, messages: Messages) -> float:
    """Seconds per step of the environment: plant, sensors and run controller."""
    estimates = _estimates(messages)
    memory: deque[tuple[str, bytes]] = deque(maxlen=1)
    stays = ProcessStarter(lambda _: None, lambda _: True, lambda before, asked: before | asked)
    controller = RunController(build_environment(setup), (), stays)
    began_s = time.thread_time()
    said = controller.begin()
    while True:
        for message in said:
            memory.append((topic(message), encode(message)))
        if controller.finished:
            return (time.thread_time() - began_s) / STEPS
        said = controller.take(decode(*estimates.popleft()))


def _recorder(setup: Setup, messages: Messages) -> float:
    """Seconds per step of the recorder: the file, and the whole steps for subscribers."""
    scenario = setup.scenario
    frames = frame_format(scenario)
    with tempfile.TemporaryDirectory() as folder:
        recorder = McapRecorder(
            Path(folder) / "run.mcap", scenario.rounds, setup.time_step_s, frames
        )
        steps = WholeSteps(scenario.nodes, scenario.rounds, frames)
        began_s = time.thread_time()
        for name, data in messages:
            recorder.record([(name, data)])
            steps.take(name, data)
        recorder.close()
        return (time.thread_time() - began_s) / STEPS


def _network_us(setup: Setup, short: Setup) -> dict[str, float]:
    """Microseconds of all processors per step: of the loop of bytes, and of the network."""
    traffic = traffic_of(in_memory(short))
    runs = {
        "bytes": [partial(floor_rate, load_of(one, traffic, says=False)) for one in (setup, short)],
        "lockstep": [partial(lockstep_rate, one) for one in (setup, short)],
    }
    spent: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(NETWORK_TURNS):
        for name, (long, shorter) in runs.items():
            spent[name].append(pace_of(long, shorter).processor_s)
    return {name: median_us(values) for name, values in spent.items()}


if __name__ == "__main__":
    main()
