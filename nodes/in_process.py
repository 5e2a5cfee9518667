"""The in-process driver: world and nodes in one thread, messages handed over in a queue.

It is the reference: no process, no clock, one order of events that depends on nothing but its
arguments. Tests make it hostile through `link` (what becomes of a frame on its way) and `pick`
(which waiting message is delivered next); the result must not depend on `pick`.
"""

from collections.abc import Callable, Iterable, Sequence

from nodes import state_machine, world
from nodes.messages import (
    CycleClosed,
    Grant,
    Measured,
    Message,
    NodeEvent,
    ShareHeard,
    ShareSent,
    Truth,
    WorldEvent,
    encode,
    topic,
)
from nodes.recording import Recorder
from nodes.state_machine import NodeConfig, NodeState, Phase
from nodes.world import WorldConfig

WORLD = -1
Link = Callable[[int, int, bytes], Iterable[bytes]]
Pick = Callable[[int], int]


def lossless(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
    """The link that delivers each frame once."""
    return (frame,)


def first_come(waiting: int) -> int:
    """Deliver in the order of sending."""
    return 0


def run(
    world_config: WorldConfig,
    configs: Sequence[NodeConfig],
    recorder: Recorder,
    *,
    link: Link = lossless,
    pick: Pick = first_come,
    on_step: Callable[[int], None] = lambda completed: None,
) -> list[NodeState]:
    """Run to the last step; returns the final states of the nodes.

    `on_step` is told the number of completed steps whenever it grows.
    """
    audience = [[c.index for c in configs if i in c.neighbours] for i in range(len(configs))]
    states = [state_machine.initial_state(config) for config in configs]
    queue: list[tuple[int, NodeEvent | WorldEvent]] = []

    def post(messages: Sequence[Message]) -> None:
        for message in messages:
            recorder.record(topic(message), encode(message))
            queue.extend(_deliveries(message, audience, link))

    world_state, messages = world.begin(world_config)
    post(messages)
    completed = 0
    while not world.finished(world_config, world_state):
        if not queue:
            queue.extend(_close_oldest_cycle(states))
        destination, event = queue.pop(pick(len(queue)))
        if destination == WORLD:
            world_state, messages = world.step(world_config, world_state, event)  # type: ignore[arg-type]
        else:
            config = configs[destination]
            states[destination], messages = state_machine.step(config, states[destination], event)  # type: ignore[arg-type]
        post(messages)
        if world_state.completed > completed:
            completed = world_state.completed
            on_step(completed)
    return states


def _deliveries(
    message: Message, audience: list[list[int]], link: Link
) -> Iterable[tuple[int, NodeEvent | WorldEvent]]:
    """Who gets a message, as events."""
    match message:
        case ShareSent():
            return [
                (receiver, ShareHeard(message.node, frame))
                for receiver in audience[message.node]
                for frame in link(message.node, receiver, message.frame)
            ]
        case Measured():
            return [(message.node, message)]
        case Grant():
            return [(node, message) for node in range(len(audience))]
        case Truth():
            return []
        case _:
            return [(WORLD, message)]


def _close_oldest_cycle(states: list[NodeState]) -> list[tuple[int, NodeEvent | WorldEvent]]:
    """Nothing is under way and somebody still waits: the time of the oldest open cycle is over."""
    waiting = [
        (s.cycle, s.group, i)
        for i, s in enumerate(states)
        if s.phase in (Phase.GRANT, Phase.SHARES)
    ]
    assert waiting, "the network stands still although no node waits for a share"
    oldest = min(waiting)[:2]
    return [(node, CycleClosed(*part)) for *part, node in waiting if tuple(part) == oldest]
