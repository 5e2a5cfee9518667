"""Processor time of a node's step: the events of one node are recorded and replayed."""

import time

import msgspec

from concord.nodes import node as state_machine
from concord.nodes.messages import NodeEvent
from concord.nodes.node_state import NodeConfig, NodeState
from concord.runtime import in_process
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.setup import Setup

_STEPS, _REPLAYS = 20, 9


def node_update_us(setup: Setup) -> float:
    """Return the microseconds that a step takes at the node with the most neighbours.

    A step is all that the node does in it: prediction, readings, frames in both directions,
    fusion. The first steps of the scenario are replayed without its changes; the fastest of nine
    replays counts, because other programs can only slow one down.
    """
    scenario = setup.scenario
    short = msgspec.structs.replace(scenario, steps=min(scenario.steps, _STEPS), changes=())
    setup = msgspec.structs.replace(setup, scenario=short)
    configs = [build_node(setup, node) for node in range(short.nodes)]
    busiest = max(configs, key=lambda config: len(config.neighbours))
    events: list[NodeEvent] = []

    def watch(config: NodeConfig, event: NodeEvent, _: NodeState) -> None:
        if config.index == busiest.index:
            events.append(event)

    in_process.run(build_environment(setup), configs, MemoryRecorder(), watch=watch)  # type: ignore[arg-type]
    return min(_replayed_ns(busiest, events) for _ in range(_REPLAYS)) / short.steps / 1e3


def _replayed_ns(config: NodeConfig, events: list[NodeEvent]) -> int:
    state = state_machine.initial_state(config)
    started = time.process_time_ns()
    for event in events:
        state, _ = state_machine.step(config, state, event)
    return time.process_time_ns() - started
