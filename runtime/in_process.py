"""The in-process driver: environment and nodes in one thread, messages handed over in a queue.

It is the reference: no process, no clock, one order of events that depends on nothing but its
arguments. Tests make it hostile through `link` (what becomes of a frame on its way) and `pick`
(which waiting message is delivered next), and look on through `watch`; the result must not depend
on `pick`.
"""

from collections.abc import Callable, Iterable, Sequence

from concord.nodes import node as state_machine
from concord.nodes import node_changes
from concord.nodes.changes import Event, Gone, Settings, Welcome
from concord.nodes.commands import Scripted
from concord.nodes.environment_state import EnvironmentConfig
from concord.nodes.messages import (
    CycleClosed,
    EnvironmentEvent,
    EnvironmentMessage,
    Grant,
    Measured,
    NodeEvent,
    NodeMessage,
    ShareHeard,
    ShareSent,
    Truth,
    encode,
    topic,
)
from concord.nodes.node_state import NodeConfig, NodeState, Phase
from concord.nodes.run_controller import ProcessStarter, RunController
from concord.runtime.recording import Recorder

ENVIRONMENT = -1
Link = Callable[[int, int, bytes], Iterable[bytes]]
Pick = Callable[[int], int]
Watch = Callable[[NodeConfig, NodeEvent | Welcome, NodeState], None]


def lossless(sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
    """The link that delivers each frame once."""
    return (frame,)


def first_come(waiting: int) -> int:
    """Deliver in the order of sending."""
    return 0


def unwatched(config: NodeConfig, event: NodeEvent | Welcome, state: NodeState) -> None:
    """No-op observer."""


def _as_they_are(before: Settings, asked: Settings) -> Settings:
    return {**before, **asked}


def run(
    environment_config: EnvironmentConfig,
    configs: Sequence[NodeConfig],
    recorder: Recorder,
    *,
    link: Link = lossless,
    pick: Pick = first_come,
    watch: Watch = unwatched,
    on_step: Callable[[int], None] = lambda completed: None,
    script: Sequence[Scripted] = (),
    check: Callable[[Settings, Settings], Settings] = _as_they_are,
) -> list[NodeState]:
    """Run to the last step; returns the final states of the nodes.

    `on_step` is told the number of completed steps whenever it grows; `script` is what becomes of
    the network, in which `check` completes settings. `watch` is shown what every event made of its
    node, and of a node that is back its welcome.
    """
    beginnings, configs = list(configs), list(configs)
    states = [state_machine.initial_state(config) for config in configs]
    queue: list[tuple[int, NodeEvent | EnvironmentEvent]] = []
    out: set[int] = set()

    def start(node: int) -> bool:
        out.discard(node)
        # Messages to its former life are lost.
        queue[:] = [one for one in queue if one[0] != node]
        return True

    def post(messages: Sequence[NodeMessage | EnvironmentMessage]) -> None:
        for message in messages:
            recorder.record([(topic(message), encode(message))])
            if isinstance(message, Welcome):
                node = message.node
                configs[node], states[node] = node_changes.begin_late(beginnings[node], message)
                watch(configs[node], message, states[node])
            queue.extend(_deliveries(message, controller.config.neighbours, link))

    controller = RunController(environment_config, script, ProcessStarter(out.add, start, check))
    post(controller.begin())
    completed = 0
    while not controller.finished:
        if not queue:
            queue.extend(_close_oldest_cycle(states, out))
        destination, event = queue.pop(pick(len(queue)))
        if destination == ENVIRONMENT:
            post(controller.take(event))  # type: ignore[arg-type]
        elif destination not in out:
            config, state = configs[destination], states[destination]
            state, messages = state_machine.step(config, state, event)  # type: ignore[arg-type]
            if state.phase is Phase.CHANGE:
                config, state, more = node_changes.apply(config, state)
                messages += more
            configs[destination], states[destination] = config, state
            post(messages)
            watch(config, event, state)  # type: ignore[arg-type]
        if controller.state.completed > completed:
            completed = controller.state.completed
            on_step(completed)
    return states


def _deliveries(
    message: NodeMessage | EnvironmentMessage, neighbours: Sequence[Sequence[int]], link: Link
) -> Iterable[tuple[int, NodeEvent | EnvironmentEvent]]:
    """Return the receivers of a message, each with its event, where node i hears neighbours[i]."""
    match message:
        case ShareSent():
            return [
                (receiver, ShareHeard(message.node, frame))
                for receiver, heard in enumerate(neighbours)
                if message.node in heard
                for frame in link(message.node, receiver, message.frame)
            ]
        case Measured():
            return [(message.node, message)]
        case Grant():
            return [(node, message) for node in range(len(neighbours))]
        case Truth() | Event() | Gone() | Welcome():
            return []
        case _:
            return [(ENVIRONMENT, message)]


def _close_oldest_cycle(
    states: list[NodeState], out: set[int]
) -> list[tuple[int, NodeEvent | EnvironmentEvent]]:
    """End the oldest open cycle: no message is under way and some node still waits."""
    waiting = [
        (s.cycle, s.group, i)
        for i, s in enumerate(states)
        if s.phase in (Phase.GRANT, Phase.SHARES) and i not in out
    ]
    assert waiting, "the network stands still although no node waits for a share"
    oldest = min(waiting)[:2]
    return [(node, CycleClosed(*group)) for *group, node in waiting if tuple(group) == oldest]
