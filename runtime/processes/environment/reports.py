"""Reports of the environment process: state, clock, processes it waits for, last message."""

import time
from collections.abc import Sequence

import msgspec

from concord.nodes import environment
from concord.nodes.changes import Event, Gone, Joined, Left
from concord.nodes.environment_state import EnvironmentConfig, EnvironmentState
from concord.nodes.run_controller import RunController
from concord.runtime.processes.clock import EnvironmentClock
from concord.runtime.processes.environment.notices import NetworkState
from concord.runtime.processes.recorder.process import Finished


def in_words(names: Sequence[str]) -> str:
    """Processes by their names."""
    return ", ".join(f"node {name}" if name.isdecimal() else f"the {name}" for name in names)


def membership_in_words(event: Event) -> str:
    """Say which node is gone, has left or is back; empty for other changes."""
    match event.change:
        case Gone(node):
            return f"node {node} is gone from step {event.step} on; the others go on without it"
        case Left(node):
            return f"node {node} left at step {event.step}, as asked"
        case Joined(node):
            return f"node {node} is back from step {event.step} on"
    return ""


def standing(
    run: str, setup: bytes, controller: RunController, *, begun: bool, refused: int
) -> bytes:
    """Encode how the network stands."""
    state = controller.state
    return msgspec.json.encode(
        NetworkState(
            run,
            msgspec.Raw(setup),
            begun,
            state.completed,
            state.released,
            controller.paused,
            controller.steps_per_second,
            environment.members(controller.config, state),
            state.standing,
            refused,
        )
    )


def last_words(config: EnvironmentConfig, state: EnvironmentState) -> bytes:
    """Return the message that tells the recorder that nothing more will come."""
    # In real time the others may still be on their way, or lost.
    last = config.steps - 1
    members = sorted(node for node, latest in state.latest.items() if latest.step == last)
    return msgspec.json.encode(Finished(last, members))


def waits_for(config: EnvironmentConfig, state: EnvironmentState, *, timed: bool) -> str:
    """Name the processes that the network waits for, and the cure; empty for none.

    A `timed` network waits for the recorder alone.
    """
    if environment.finished(config, state):
        return "the recorder, which has not kept everything yet"
    if timed:
        return ""
    late = [str(node) for node in _late(config, state)]
    if not late:
        return ""
    return (
        f"the estimates of step {state.completed} of {in_words(late)}; kill and restart who does "
        "not go on (concord control), or end the run"
    )


def _late(config: EnvironmentConfig, state: EnvironmentState) -> list[int]:
    """The nodes that have not estimated the oldest step under way, ascending."""
    number = state.completed
    came = state.estimates.get(number, {})
    return [
        node
        for node in environment.members(config, state)
        if not state.idle and state.since.get(node, 0) <= number and node not in came
    ]


def clock(start_s: float | None) -> bytes:
    """The answer to what this process's clock shows, and when step 0 begins on it."""
    return msgspec.json.encode(EnvironmentClock(time.monotonic(), start_s))
