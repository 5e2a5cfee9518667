"""One node of the network as a pure state machine: events in, messages out.

The story of a step: a `Measured` opens it; then come `rounds` communication cycles. In each the
node sends if the schedule (or the arbiter's grant) says so, waits for exactly the frames that are
due from its neighbours, and fuses; after the last it emits an `Estimate`. `CycleClosed` ends a
cycle with whatever has come. A `Gone` says that nobody need wait for a neighbour any more.

A heartbeat that brings changes stops the machine in phase CHANGE, in which `nodes/node_changes.py`
makes the configuration and the state with which it goes on.

This file never does I/O, reads a clock or draws a number, and never raises for a peer's fault: a
share that is late, early, repeated, missing or malformed is dropped, kept or counted here.
"""

from functools import lru_cache
from typing import Any, cast

from msgspec.structs import replace

from bus.schedule import Schedule
from filters.linalg import pack_upper
from nodes.changes import Gone
from nodes.due_frames import take_due
from nodes.estimator import KeepsZonotope
from nodes.faults import hangs, is_silent
from nodes.hearing import (
    EARLY_CYCLES,
    MOST_EARLY,
    file_early,
    hear,
    hear_late,
    last_early_cycle,
    let_in_overtaken,
)
from nodes.messages import (
    Bid,
    CycleClosed,
    Estimate,
    Grant,
    Measured,
    NodeEvent,
    NodeMessage,
    ShareHeard,
    ShareSent,
    to_wire,
)
from nodes.node_state import Inbox, NodeConfig, NodeState, Phase, count, counted
from nodes.sender_faults import spoken
from nodes.share import payload_bytes, to_frames


def initial_state(config: NodeConfig) -> NodeState:
    """The state before the first heartbeat."""
    return NodeState(
        Phase.MEASUREMENT,
        config.first_step - 1,
        config.first_cycle,
        0,
        (),
        config.estimator.start(),
        Inbox({}, {}, {}, {}, {}, {}),
        {},
        frozenset(config.standing.absent),
    )


def step(
    config: NodeConfig, state: NodeState, *events: NodeEvent
) -> tuple[NodeState, list[NodeMessage]]:
    """Take an event, or several that came together; returns the next state and what to send, in
    order."""
    outbox: list[NodeMessage] = []
    state, left = take_due(config, state, events)
    for event in left:
        match event:
            case ShareHeard():
                state = hear(config, state, event)
            case Measured():
                state = _keep_measured(state, event)
            case Grant():
                state = _keep_grant(config, state, event)
            case Gone():
                state = replace(state, absent=state.absent | {event.node})
            case CycleClosed():
                is_open = state.phase in (Phase.GRANT, Phase.SHARES)
                if is_open and (event.cycle, event.group) == (state.cycle, state.group):
                    state = _close_group(config, state, outbox)
    return advance(config, state, outbox), outbox


def awaited_neighbours(config: NodeConfig, state: NodeState) -> list[int]:
    """In phase SHARES: the neighbours whose shares are due and have not come, ascending."""
    cycle, came = state.cycle, state.inbox.shares
    missing = list(_due(config, state))
    if came:
        missing = [j for j in missing if (cycle, j) not in came]
    if not (missing and config.faults.standing):
        return missing
    overtaken = state.inbox.overtaken
    return [
        j
        for j in missing
        if not overtaken.get((cycle, j)) and not is_silent(config.faults, state.step, cycle, j)
    ]


def is_complete(config: NodeConfig, state: NodeState) -> bool:
    """Whether the open part of a cycle lacks nothing that is due."""
    return state.phase is Phase.SHARES and not awaited_neighbours(config, state)


def advance(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    """Go on as far as what has come allows; what there is to say goes to the outbox."""
    while True:
        if state.phase is Phase.MEASUREMENT and state.step + 1 in state.inbox.measured:
            if state.inbox.measured[state.step + 1].changes:
                return replace(state, phase=Phase.CHANGE)
            state = _begin_step(config, state)
            state = _open_group(config, state, outbox)
        elif state.phase is Phase.GRANT and (state.cycle, state.group) in state.inbox.grants:
            winners = state.inbox.grants[state.cycle, state.group]
            state = replace(state, phase=Phase.SHARES, won=state.won + winners)
            if config.index in winners:
                state = _send(config, state, outbox)
        elif is_complete(config, state) and not config.timed:
            state = _close_group(config, state, outbox)
        else:
            return state


def _begin_step(config: NodeConfig, state: NodeState) -> NodeState:
    number = state.step + 1
    measured = dict(state.inbox.measured)
    content, troubles = config.estimator.begin_step(state.content, measured.pop(number))
    inbox = replace(state.inbox, measured=measured)
    state = replace(state, step=number, content=content, inbox=inbox)
    state = count(state, *troubles)
    return file_early(config, state) if state.inbox.early else state


def _open_group(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    """Begin a part of a cycle: bid where there are slots to win, send where a slot is owned."""
    if state.inbox.late:
        state = hear_late(config, state)
    part = config.parts(state.cycle)[state.group]
    contenders: tuple[int, ...] = ()
    if part.dynamic_slots:
        contenders = contenders_left(config.schedule, state.cycle, state.won)
    if config.index in contenders:
        outbox.append(_bid(config, state))
    phase = Phase.GRANT if contenders else Phase.SHARES
    if phase is not state.phase:
        state = replace(state, phase=phase)
    if config.index in part.senders:
        state = _send(config, state, outbox)
    return state


def contenders_left(schedule: Schedule, cycle: int, won: tuple[int, ...]) -> tuple[int, ...]:
    """Who may still ask for a dynamic slot in this cycle: nobody sends twice."""
    served = won + schedule.static_senders(cycle)
    return tuple(node for node in schedule.contenders(cycle) if node not in served)


def _bid(config: NodeConfig, state: NodeState) -> Bid:
    slots = config.slots(config.index, state.cycle)
    # Composing changes nothing here: it says how long the share would be.
    _, body = config.estimator.compose(state.content)
    hung = hangs(config.faults, state.step, config.index)
    bid = None if hung else config.estimator.bid(state.content)
    return Bid(config.index, state.cycle, bid, payload_bytes(body, slots), state.group)


def _send(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    faults, step, cycle = config.faults, state.step, state.cycle
    if faults.standing and is_silent(faults, step, cycle, config.index):
        return count(state, "silent")
    content, body = config.estimator.compose(state.content)
    if faults.standing:
        body = spoken(faults, step, cycle, config.index, body)
    slots = config.slots(config.index, cycle)
    frames = to_frames(body, cycle, slots, config.cycle_counts)
    outbox.extend(ShareSent(config.index, cycle, frame) for frame in frames)
    counters = counted(state.counters, *["sent" for _ in frames])
    return replace(state, content=content, counters=counters)


def _due(config: NodeConfig, state: NodeState) -> tuple[int, ...]:
    """Neighbours that send in the open part of the cycle, as far as the node knows. Of one that is
    out there is what came before its end."""
    due = config.parts(state.cycle)[state.group].neighbours
    if state.inbox.grants:
        granted = state.inbox.grants.get((state.cycle, state.group), ())
        due = tuple(j for j in config.neighbours if j in due or j in granted)
    if not state.absent:
        return due
    came = state.inbox.shares
    return tuple(j for j in due if j not in state.absent or (state.cycle, j) in came)


def _close_group(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    if state.inbox.overtaken:
        state = let_in_overtaken(config, state)
    due = _due(config, state)
    # Without a grant nobody knows who won: what came from a contender then stands as sent.
    usable = due if state.phase is Phase.SHARES else config.neighbours
    came, cycle = state.inbox.shares, state.cycle
    shares = tuple([came.get((cycle, j)) if j in usable else None for j in config.neighbours])
    missed = [j for j in due if came.get((cycle, j)) is None]
    content, troubles = config.estimator.fuse(state.content, shares)
    state = count(replace(state, content=content), *troubles, *["missed" for _ in missed])
    if state.group + 1 < len(config.parts(state.cycle)):
        return _open_group(config, replace(state, group=state.group + 1), outbox)
    return _close_cycle(config, state, outbox)


def _close_cycle(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    following = state.cycle + 1
    inbox = _forget_before(state, following)
    state = replace(state, cycle=following, group=0, won=(), inbox=inbox)
    if (following - config.first_cycle) % config.rounds:
        return _open_group(config, state, outbox)
    outbox.append(_estimate(config, state))
    finished = state.step + 1 == config.steps
    return replace(state, phase=Phase.FINISHED if finished else Phase.MEASUREMENT)


def _estimate(config: NodeConfig, state: NodeState) -> Estimate:
    belief = config.estimator.belief(state.content)
    ages = config.estimator.ages(state.content)
    generators = None
    if _keeps_zonotope(type(config.estimator)):
        generators = cast(KeepsZonotope, config.estimator).generators(state.content)
    return Estimate(
        config.index,
        state.step,
        to_wire(belief.mean),
        to_wire(pack_upper(belief.cov)),
        ages.tolist(),
        state.counters,
        None if generators is None else to_wire(generators),
    )


@lru_cache
def _keeps_zonotope(kind: type) -> bool:
    # Kept: to ask a protocol takes longer than to tell an estimate.
    return issubclass(kind, KeepsZonotope)


def _keep_measured(state: NodeState, event: Measured) -> NodeState:
    if event.step <= state.step or event.step in state.inbox.measured:
        return count(state, "repeated measured")
    if event.step > state.step + EARLY_CYCLES:
        return count(state, "rejected future")
    if not fits(state, event):
        return count(state, "rejected readings")
    if state.pattern is None or (state.pattern.control is None and event.control is not None):
        state = replace(state, pattern=event)
    measured = {**state.inbox.measured, event.step: event}
    return replace(state, inbox=replace(state.inbox, measured=measured))


def fits(state: NodeState, measured: Measured) -> bool:
    """Whether readings and control are as many as they have been from the first heartbeat on."""
    known = state.pattern
    if known is None:
        return True
    lengths = {len(one.control) for one in (known, measured) if one.control is not None}
    return _shape(known) == _shape(measured) and len(lengths) <= 1


def _shape(measured: Measured) -> tuple[int, int]:
    readings = measured.readings
    return len(readings), len(readings[0]) if readings else 0


def _keep_grant(config: NodeConfig, state: NodeState, event: Grant) -> NodeState:
    key = (event.cycle, event.group)
    if key < (state.cycle, state.group) or key in state.inbox.grants:
        return count(state, "repeated grant")
    is_far = event.cycle > last_early_cycle(config, state)
    if is_far or len(state.inbox.grants) >= MOST_EARLY:
        return count(state, "rejected future")
    grants = {**state.inbox.grants, key: tuple(event.winners)}
    return replace(state, inbox=replace(state.inbox, grants=grants))


def _forget_before(state: NodeState, cycle: int) -> Inbox:
    inbox = state.inbox
    if not (inbox.grants or inbox.parts or inbox.overtaken):
        return replace(inbox, shares=_since(cycle, inbox.shares))
    return replace(
        inbox,
        grants=_since(cycle, inbox.grants),
        parts=_since(cycle, inbox.parts),
        shares=_since(cycle, inbox.shares),
        overtaken=_since(cycle, inbox.overtaken),
    )


def _since(cycle: int, kept: dict[tuple[int, int], Any]) -> dict[tuple[int, int], Any]:
    return {key: value for key, value in kept.items() if key[0] >= cycle} if kept else kept
