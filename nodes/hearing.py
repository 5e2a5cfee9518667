"""What a node makes of the frames that arrive: kept with their share, or counted by why not.

Nothing here is waited for, used or answered, and nothing raises for a peer's fault.
"""

from collections.abc import Collection

from nodes.estimator import Rejected
from nodes.link_state import hears
from nodes.messages import ShareHeard
from nodes.node_state import NodeConfig, NodeState, count, counted
from nodes.share import Fragment, fragments_of, read_body, read_frame

# How many steps a neighbour's share may be ahead of us and still be kept: bounds the inbox. The
# world lets nobody run further ahead than its lead.
EARLY_STEPS = 8
# And cycles at least, as a change may bring more rounds than there are now.
EARLY_CYCLES = 512


def hear(config: NodeConfig, state: NodeState, event: ShareHeard) -> NodeState:
    """File a frame under its cycle and sender, or count why not."""
    if event.sender not in config.neighbours:
        return count(state, "rejected stranger")
    try:
        fragment = read_frame(event.frame)
    except Rejected as rejected:
        return count(state, f"rejected {rejected.reason}")
    cycle = fragment.cycle
    if cycle % config.cycle_counts != fragment.cycle_count:
        return count(state, "rejected cycle-count")
    if cycle < state.cycle:
        return count(state, "late")
    if cycle > state.cycle + max(EARLY_STEPS * config.rounds, EARLY_CYCLES):
        return count(state, "rejected future")
    if cycle >= _end_cycle(config, state):
        key = (event.sender, cycle, fragment.frame_id)
        if key in state.inbox.early:
            return count(state, "repeated")
        early = {**state.inbox.early, key: fragment}
        return state._replace(inbox=state.inbox._replace(early=early))
    return _file(config, state, event.sender, fragment)


def _end_cycle(config: NodeConfig, state: NodeState) -> int:
    """The first cycle after the step that was begun last."""
    return config.first_cycle + (state.step + 1 - config.first_step) * config.rounds


def file_early(config: NodeConfig, state: NodeState) -> NodeState:
    """Frames of the step that has just begun have waited for it."""
    end = _end_cycle(config, state)
    early = state.inbox.early
    due = [(key[0], fragment) for key, fragment in early.items() if fragment.cycle < end]
    early = {key: fragment for key, fragment in early.items() if fragment.cycle >= end}
    state = state._replace(inbox=state.inbox._replace(early=early))
    for sender, fragment in due:
        state = _file(config, state, sender, fragment)
    return state


def _file(config: NodeConfig, state: NodeState, sender: int, fragment: Fragment) -> NodeState:
    """A frame of the open step: keep it with its share, or count why not."""
    frame_id, cycle, _, data = fragment
    try:
        parts_needed = fragments_of(data)
    except Rejected as rejected:
        return count(state, f"rejected {rejected.reason}")
    schedule = config.schedule
    if sender not in schedule.static_senders(cycle) and sender not in schedule.contenders(cycle):
        return count(state, "rejected unscheduled")
    frame_ids = [slot.frame_id for slot in config.slots(sender, cycle)]
    # A share takes the first of its sender's slots, as many as it needs.
    if frame_id not in frame_ids[:parts_needed]:
        return count(state, "rejected wrong-slot")
    key = (cycle, sender)
    parts = state.inbox.parts.get(key, {})
    if key in state.inbox.shares or frame_id in parts:
        return count(state, "repeated")
    # The transport brings what the simulated link loses, so that nobody waits for it in vain.
    number = frame_ids.index(frame_id)
    arrives = config.links.perfect or hears(
        config.links, state.step, cycle, sender, config.index, number
    )
    parts = {**parts, frame_id: data if arrives else None}
    if not arrives:
        state = count(state, "lost")
    if len(parts) == parts_needed:
        return _complete(config, state, key, parts.values())
    return state._replace(inbox=state.inbox._replace(parts={**state.inbox.parts, key: parts}))


def _complete(
    config: NodeConfig, state: NodeState, key: tuple[int, int], fragments: Collection[bytes | None]
) -> NodeState:
    """All frames of a share are there or lost: keep what it means; None marks one of no use."""
    share, counters, inbox = None, state.counters, state.inbox
    whole = [fragment for fragment in fragments if fragment is not None]
    if len(whole) == len(fragments):
        try:
            share = config.estimator.accept(read_body(whole))
            counters = counted(counters, "heard")
        except Rejected as rejected:
            counters = counted(counters, f"rejected {rejected.reason}")
    parts = inbox.parts
    if key in parts:
        parts = {k: v for k, v in parts.items() if k != key}
    inbox = inbox._replace(parts=parts, shares={**inbox.shares, key: share})
    return state._replace(counters=counters, inbox=inbox)
