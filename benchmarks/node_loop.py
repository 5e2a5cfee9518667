"""One node fed from memory, beside the bare loop of the same messages and filter calls.

The node never waits and zenoh is not used, so the figure is the processor time of a step in one
node. In a network, other processes use the processor and fill its caches before each wait. `cold`
therefore clears the caches wherever a node would wait for the first message of a round.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import cast
from unittest.mock import patch

import numpy as np

from benchmarks.bare_loop import Load, language_of, pass_on
from benchmarks.lockstep import GRAPH, NODES, load_of, setup_of, traffic_of
from benchmarks.measure import (
    BenchmarkFigures,
    figure,
    in_turns,
    median_us,
    ratio,
    say,
)
from concord.nodes.messages import END
from concord.runtime.drivers import in_memory
from concord.runtime.network.links import ZenohEndpoints
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.node import lockstep
from concord.runtime.processes.node.membership import Membership
from concord.runtime.processes.node.process import run_node
from concord.scenarios.build import build_node
from concord.scenarios.setup import Setup

STEPS, TURNS = 150, 7
NODE = 0
# More than the caches of a core hold.
_OTHERS = np.zeros(1 << 21)

Messages = Sequence[tuple[str, bytes]]


class RecordedNetwork:
    """A node's place in a network that was recorded; times it from its first word to its last."""

    def __init__(self, messages: Messages, first_of_round: Sequence[str], steps: int) -> None:
        self._queues: dict[str, deque[bytes]] = {}
        for topic, data in messages:
            self._queues.setdefault(topic, deque()).append(data)
        self._first_of_round, self._left = first_of_round, steps
        self._heard: dict[str, Callable[[str, bytes], None]] = {}
        self.spent_s = 0.0

    def join(self, *_: object) -> None:
        """Start the measurement; every peer is present."""
        self.spent_s -= time.thread_time()

    def receive(self, topic: str) -> tuple[str, bytes]:
        """Return the next message of a topic, which is there already."""
        if topic in self._first_of_round:
            self.spent_s += time.thread_time()
            np.add(_OTHERS, 1.0, out=_OTHERS)
            self.spent_s -= time.thread_time()
        return topic, self._queues[topic].popleft()

    def send(self, topic: str, data: bytes) -> None:
        """Drop the message; after the node's last estimate, deliver the end of the run."""
        if topic.startswith("estimate/"):
            self._left -= 1
            if not self._left:
                self.spent_s += time.thread_time()
                if "end" in self._heard:
                    self._heard["end"]("end", END)

    def listen(self, topic: str, heard: Callable[[str, bytes], None]) -> None:
        """Nothing is said but at the end."""
        self._heard[topic] = heard

    def receive_at_once(self, _topic: str) -> None:
        """Nothing but what is asked for."""

    def watch(self, *_: object) -> None:
        """Ignore the request, because no peer joins or leaves."""

    def wake(self, *_: object) -> None:
        """Do nothing, because no thread waits."""

    def close(self) -> None:
        """Nothing was opened."""


def main() -> BenchmarkFigures:
    """Print and return microseconds per step, and their ratios."""
    setup = setup_of(STEPS)
    messages = in_memory(setup)
    load = load_of(setup, traffic_of(messages))
    contestants: dict[str, Callable[[], float]] = {}
    for warmth, is_cold in (("warm", False), ("cold", True)):
        node = partial(node_s, setup, messages, is_cold)
        bare = partial(bare_node_s, load, messages, is_cold)
        contestants |= {warmth: node, f"{warmth}, bare": bare}
    given = in_turns(contestants, TURNS)
    say(f"a node of {NODES}, {GRAPH}, fed from memory, beside its bare loop; {TURNS} turns")
    results: BenchmarkFigures = {}
    for name, spent in given.items():
        results[f"{name} us"] = figure([1e6 * one for one in spent], "us/step", "less")
        if name.endswith("bare"):
            continue
        floor = given[f"{name}, bare"]
        of_floor = results[f"{name}, part of the bare loop"] = ratio(floor, spent)
        say(
            f"  {name:<16}{median_us(spent):8.1f} us per step, bare loop {median_us(floor):8.1f}: "
            f"{of_floor.value:.2f} ({of_floor.low:.2f} - {of_floor.high:.2f}) of its rate"
        )
    return results


def node_s(setup: Setup, messages: Messages, cold: bool) -> float:
    """Seconds per step of a node as it is."""
    memory = recorded_network(setup.neighbours[NODE], messages, cold)
    links = ZenohEndpoints("peer", (), ())
    membership = Membership("memory", links, build_node(setup, NODE), "")
    with patch.object(lockstep, "Transport", lambda *_: memory):
        run_node(membership, lockstep.LockstepNode(membership))
    return memory.spent_s / STEPS


def bare_node_s(load: Load, messages: Messages, cold: bool) -> float:
    """Seconds per step of the bare loop."""
    memory = recorded_network(load.neighbours[NODE], _with_own_frames(load, messages), cold)
    pass_on(cast(Transport, memory), load, NODE)
    return memory.spent_s / STEPS


def _with_own_frames(load: Load, messages: Messages) -> Messages:
    """Return the messages with the frames that nodes of the bare loop send, and can read."""
    language = language_of(load)
    cycles: dict[str, int] = {}
    found: list[tuple[str, bytes]] = []
    for name, data in messages:
        kind, _, node = name.partition("/")
        if kind != "share":
            found.append((name, data))
            continue
        cycles[node] = cycles.get(node, -1) + 1
        found.append((name, language.share(int(node), cycles[node])))
    return found


def recorded_network(neighbours: Sequence[int], messages: Messages, cold: bool) -> RecordedNetwork:
    """Return what a node hears in a run; a cold one clears the caches before each first message."""
    first_of_round = [f"measured/{NODE}", f"share/{neighbours[0]}"] if cold else []
    return RecordedNetwork(messages, first_of_round, STEPS)


if __name__ == "__main__":
    main()
