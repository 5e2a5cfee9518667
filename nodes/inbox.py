"""Frames that arrive at a node: kept with their share, or counted with the reason.

Nothing here is waited for, used or answered, and nothing raises for a peer's fault. Frames that are
due take a shorter way (`nodes/inbox.py`).
"""

from collections.abc import Collection, Sequence
from typing import Any

from msgspec.structs import replace

from concord.bus.bus import Fragment, Rejected, SharePlace
from concord.nodes.faults.links import Arrival, arrival
from concord.nodes.faults.losses import hears
from concord.nodes.faults.retries import Passage
from concord.nodes.faults.senders import spoofed
from concord.nodes.messages import NodeEvent, ShareHeard
from concord.nodes.node_state import Inbox, NodeConfig, NodeState, Phase, count

# How many steps a neighbour's share may be ahead of us and still be kept: bounds the inbox. The
# environment lets no node run further ahead than its lead.
EARLY_STEPS = 8
# And cycles at least, as a change may bring more rounds than there are now.
EARLY_CYCLES = 512
# Largest number of frames, or grants, kept for later.
MOST_EARLY = 4096
_LATE = "late"


def hear(config: NodeConfig, state: NodeState, event: ShareHeard) -> NodeState:
    """File a frame under its cycle and sender, or count why not."""
    # Nothing changes while a step is under way: what holds now holds for this frame as well.
    is_settled = state.phase is not Phase.MEASUREMENT
    is_stranger = event.sender not in config.neighbours
    if is_stranger and (is_settled or not _may_be_neighbour(config, event.sender)):
        return count(state, "rejected stranger")
    try:
        fragment = _read(config, state.cycle, event.frame)
    except Rejected as rejected:
        return count(state, _counter(rejected))
    if fragment.cycle >= _end_cycle(config, state):
        return _keep_early(config, state, event, fragment, is_settled)
    if is_stranger:
        return count(state, "rejected stranger")
    return _file(config, state, event.sender, fragment, event.frame)


def _may_be_neighbour(config: NodeConfig, sender: int) -> bool:
    """Whether the next step may have a link from this sender."""
    return 0 <= sender < config.schedule.nodes and sender != config.index


def _keep_early(
    config: NodeConfig, state: NodeState, event: ShareHeard, fragment: Fragment, is_settled: bool
) -> NodeState:
    """A frame of a later step waits for it; in whose slot it must be may not be settled yet."""
    cycle = fragment.cycle
    if cycle > last_early_cycle(config, state) or len(state.inbox.early) >= MOST_EARLY:
        return count(state, "rejected future")
    if is_settled:
        try:
            config.bus.place(event.sender, fragment)
        except Rejected as rejected:
            return count(state, _counter(rejected))
    # Whether the counter is that of the cycle is not settled either: one frame with each is kept.
    key = (event.sender, cycle, fragment.frame_id, fragment.count)
    if key in state.inbox.early:
        return count(state, "repeated")
    early = {**state.inbox.early, key: (fragment, event.frame)}
    return replace(state, inbox=replace(state.inbox, early=early))


def last_early_cycle(config: NodeConfig, state: NodeState) -> int:
    """The last cycle of which anything is kept before its time."""
    return state.cycle + max(EARLY_STEPS * config.rounds, EARLY_CYCLES)


def file_early(config: NodeConfig, state: NodeState) -> NodeState:
    """Frames of the step that has just begun have waited for it."""
    end = _end_cycle(config, state)
    early = state.inbox.early
    state = replace(state, inbox=replace(state.inbox, early={}))
    for (sender, cycle, *_), (fragment, frame) in early.items():
        # It may have come between two steps, when the graph and its slot were open.
        if sender not in config.neighbours:
            state = count(state, "rejected stranger")
        elif cycle >= end:
            state = _keep_early(config, state, ShareHeard(sender, frame), fragment, True)
        else:
            state = _file(config, state, sender, fragment, frame)
    return state


def hear_late(config: NodeConfig, state: NodeState) -> NodeState:
    """Frames that were under way and come in the cycle that has just begun."""
    now = [frame for cycle, frame in state.inbox.late if cycle <= state.cycle]
    late = tuple(kept for kept in state.inbox.late if kept[0] > state.cycle)
    state = replace(state, inbox=replace(state.inbox, late=late))
    for frame in now:
        try:
            _read(config, state.cycle, frame)
        except Rejected as rejected:
            state = count(state, _counter(rejected))
    return state


def let_in_overtaken(config: NodeConfig, state: NodeState) -> NodeState:
    """All others of the cycle have come: now those that they have overtaken."""
    inbox = state.inbox
    overtaken = {key: kept for key, kept in inbox.overtaken.items() if key[0] == state.cycle}
    rest = {key: kept for key, kept in inbox.overtaken.items() if key not in overtaken}
    state = replace(state, inbox=replace(inbox, overtaken=rest))
    for key, fragments in overtaken.items():
        if fragments:
            state = _complete(config, state, key, fragments)
    return state


def _read(config: NodeConfig, cycle: int, frame: bytes) -> Fragment:
    """Read a frame that comes in this cycle or before it.

    Raises:
        Rejected: with the reason of the check that failed.
    """
    fragment = config.bus.receive(frame)
    if fragment.cycle < cycle:
        raise Rejected(_LATE)
    return fragment


def _counter(rejected: Rejected) -> str:
    return _LATE if rejected.reason == _LATE else f"rejected {rejected.reason}"


def _end_cycle(config: NodeConfig, state: NodeState) -> int:
    """The first cycle after the step that was begun last."""
    return config.first_cycle + (state.step + 1 - config.first_step) * config.rounds


def _file(
    config: NodeConfig, state: NodeState, sender: int, fragment: Fragment, frame: bytes
) -> NodeState:
    """A frame of the open step: keep it with its share, or count why not."""
    try:
        place = config.bus.place(sender, fragment)
    except Rejected as rejected:
        return count(state, _counter(rejected))
    key = (fragment.cycle, sender)
    if _is_known(state.inbox, key, fragment.frame_id):
        return count(state, "repeated")
    # The transport brings what the simulated link loses, so that no node waits for it in vain.
    arrives = config.links.perfect or hears(
        config.links, state.step, fragment.cycle, sender, config.index, place.number
    )
    if not arrives:
        return _keep(config, count(state, "lost"), key, place, fragment.frame_id, None)
    if config.faults.are_active:
        return _hear_faulty(config, state, sender, fragment, place, frame)
    return _keep(config, state, key, place, fragment.frame_id, fragment.data)


def _is_known(inbox: Inbox, key: tuple[int, int], frame_id: int) -> bool:
    return key in inbox.shares or frame_id in inbox.parts.get(key, ())


def _hear_faulty(
    config: NodeConfig,
    state: NodeState,
    sender: int,
    fragment: Fragment,
    place: SharePlace,
    frame: bytes,
) -> NodeState:
    """A frame as it comes where something is wrong, and what else comes with it."""
    cycle, key = fragment.cycle, (fragment.cycle, sender)
    way = Passage(
        state.step, cycle, sender, config.index, place.number, fragment.frame_id, place.channels
    )
    came = arrival(config.faults, way, frame, config.bus)
    state = count(state, *came.counted)
    data = None
    if came.in_slot:
        try:
            data = _read_in_slot(config, cycle, sender, came.frame).data
        except Rejected as rejected:
            state = count(state, _counter(rejected))
    if came.is_overtaken:
        state = count(state, "reordered")
        overtaken = {key: (), **state.inbox.overtaken}
        state = replace(state, inbox=replace(state.inbox, overtaken=overtaken))
    state = _keep(config, state, key, place, fragment.frame_id, data)
    again = [came.frame] * came.copies
    if came.in_slot:
        again += _in_other_names(config, state, way, frame)
    for copy in again:
        state = _hear_again(config, state, key, copy)
    return _remember(state, came, cycle)


def _read_in_slot(config: NodeConfig, cycle: int, sender: int, frame: bytes) -> Fragment:
    """Read a frame that comes in a slot of this cycle.

    Raises:
        Rejected: it does not belong there.
    """
    fragment = _read(config, cycle, frame)
    if fragment.cycle > cycle:
        raise Rejected("future")
    config.bus.place(sender, fragment)
    return fragment


def _hear_again(
    config: NodeConfig, state: NodeState, key: tuple[int, int], frame: bytes
) -> NodeState:
    """A frame that comes beside the one that its sender has sent in this slot."""
    cycle, sender = key
    try:
        fragment = _read_in_slot(config, cycle, sender, frame)
    except Rejected as rejected:
        return count(state, _counter(rejected))
    if _is_known(state.inbox, key, fragment.frame_id):
        return count(state, "repeated")
    place = config.bus.place(sender, fragment)
    return _keep(config, state, key, place, fragment.frame_id, fragment.data)


def _in_other_names(
    config: NodeConfig, state: NodeState, way: Passage, frame: bytes
) -> list[bytes]:
    """Frames that the sender also sends, in slots of others."""
    victims = spoofed(config.faults, way.step, way.cycle, way.sender, way.number)
    moved = [config.bus.in_slot_of(frame, victim, way.cycle) for victim in victims]
    return [copy for copy in moved if copy is not None]


def _remember(state: NodeState, came: Arrival, cycle: int) -> NodeState:
    if not came.later:
        return state
    late = tuple((cycle + cycles, came.frame) for cycles in came.later)
    return replace(state, inbox=replace(state.inbox, late=state.inbox.late + late))


def _keep(
    config: NodeConfig,
    state: NodeState,
    key: tuple[int, int],
    place: SharePlace,
    frame_id: int,
    data: bytes | None,
) -> NodeState:
    """Keep what a frame carries with its share; None of one that is of no use."""
    inbox = state.inbox
    parts = {**inbox.parts.get(key, {}), frame_id: data}
    if len(parts) < place.frames:
        return replace(state, inbox=replace(inbox, parts={**inbox.parts, key: parts}))
    if key in inbox.overtaken:
        return replace(
            state,
            inbox=replace(
                inbox,
                parts={**inbox.parts, key: parts},
                overtaken={**inbox.overtaken, key: tuple(parts.values())},
            ),
        )
    return _complete(config, state, key, parts.values())


def _complete(
    config: NodeConfig, state: NodeState, key: tuple[int, int], fragments: Collection[bytes | None]
) -> NodeState:
    """All frames of a share are there or lost: keep what it means; None marks one of no use."""
    share, inbox = None, state.inbox
    whole = [fragment for fragment in fragments if fragment is not None]
    if len(whole) == len(fragments):
        try:
            share = config.estimator.accept(config.bus.frame_format.join(whole))
            state = count(state, "heard")
        except Rejected as rejected:
            state = count(state, _counter(rejected))
    parts = {k: v for k, v in inbox.parts.items() if k != key}
    inbox = replace(inbox, parts=parts, shares={**inbox.shares, key: share})
    return replace(state, inbox=inbox)


def take_due(
    config: NodeConfig, state: NodeState, events: Sequence[NodeEvent]
) -> tuple[NodeState, Sequence[NodeEvent]]:
    """File the frames that are due, up to the first event that is none; returns the state and the
    events from there on."""
    is_open = state.phase is Phase.SHARES or state.phase is Phase.GRANT
    if not (is_open and config.hears_all):
        return state, events
    cycle, inbox, estimator = state.cycle, state.inbox, config.estimator
    size, due_body = estimator.share_bytes, config.bus.due_body
    due = list(config.groups(cycle)[state.group].neighbours)
    if inbox.shares or inbox.parts:
        known = inbox.shares.keys() | inbox.parts.keys()
        due = [j for j in due if (cycle, j) not in known]
    shares: dict[tuple[int, int], Any] = {}
    for event in events:
        if not isinstance(event, ShareHeard) or event.sender not in due:
            break
        sender = event.sender
        body = due_body(event.frame, sender, cycle, size)
        if body is None:
            break
        try:
            shares[cycle, sender] = estimator.accept(body)
        except Rejected:
            break
        due.remove(sender)
    if not shares:
        return state, events
    taken = len(shares)
    counters = {**state.counters, "heard": state.counters.get("heard", 0) + taken}
    inbox = replace(inbox, shares={**inbox.shares, **shares})
    return replace(state, counters=counters, inbox=inbox), events[taken:]


def cut_short(config: NodeConfig, state: NodeState) -> list[int]:
    """Return the neighbours whose share is cut in the open group, and whose frames have not all
    come.

    These frames are of no use. The node waits for them, so that it counts the same frames in every
    driver.
    """
    grant = state.inbox.grants.get((state.cycle, state.group))
    if grant is None or not grant.cut_shares:
        return []
    parts = {j: state.inbox.parts.get((state.cycle, j), {}) for j in grant.cut_shares}
    return [
        j
        for j, one in grant.cut_shares.items()
        if j in config.neighbours and j not in state.absent and len(parts[j]) < one.frames
    ]
