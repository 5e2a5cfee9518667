"""What the world's process says at the end, and to people: how it stands, for whom it waits."""

from collections.abc import Sequence

import msgspec

from nodes import world
from nodes.conductor import Conductor
from nodes.notices import State
from nodes.recorder_process import Finished
from nodes.world import WorldConfig, WorldState


def in_words(names: Sequence[str]) -> str:
    """Processes by their names."""
    return ", ".join(f"node {name}" if name.isdecimal() else f"the {name}" for name in names)


def standing(run: str, setup: bytes, conductor: Conductor, *, begun: bool, refused: int) -> bytes:
    """How the network stands, to whoever asks."""
    state = conductor.state
    return msgspec.json.encode(
        State(
            run,
            msgspec.Raw(setup),
            begun,
            state.completed,
            state.released,
            conductor.paused,
            conductor.steps_per_second,
            world.members(conductor.config, state),
            state.standing,
            refused,
        )
    )


def last_words(config: WorldConfig, state: WorldState) -> bytes:
    """What tells the recorder that nothing more will come."""
    # In real time the others may still be on their way, or lost.
    last = config.steps - 1
    members = sorted(node for node, latest in state.latest.items() if latest.step == last)
    return msgspec.json.encode(Finished(last, members))


def waits_for(config: WorldConfig, state: WorldState, *, timed: bool) -> str:
    """For whom the network waits, and what can be done; nothing where no step is under way, or
    where nobody is waited for, as it is `timed`."""
    if world.finished(config, state):
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


def _late(config: WorldConfig, state: WorldState) -> list[int]:
    """Who has not estimated the oldest step that is under way, ascending."""
    number = state.completed
    came = state.estimates.get(number, {})
    return [
        node
        for node in world.members(config, state)
        if not state.idle and state.since.get(node, 0) <= number and node not in came
    ]
