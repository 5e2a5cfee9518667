"""One node of the network as a pure state machine: events in, messages out.

The story of a step: a `Measured` opens it; then come `rounds` communication cycles. In each the
node sends if the schedule (or the arbiter's grant) says so, waits for exactly the frames that are
due from its neighbours, and fuses; after the last it emits an `Estimate`. `CycleClosed` ends a
cycle with whatever has come. After a `Gone`, no node waits for that neighbour any more.

A heartbeat that brings changes stops the machine in phase CHANGE, in which `nodes/node_changes.py`
makes the configuration and the state with which it goes on. `TRANSITIONS` says what each event does
in each phase, `COMPLETIONS` what each phase waits for.

This file never does I/O, reads a clock or draws a number, and never raises for a peer's fault: a
share that is late, early, repeated, missing or malformed is dropped, kept or counted here.
"""

from functools import lru_cache
from typing import Any, cast

import numpy as np
from msgspec.structs import replace

from concord.bus.schedule import Schedule
from concord.filters.linalg import pack_upper
from concord.nodes.changes import Gone
from concord.nodes.estimator import (
    ChecksItself,
    KeepsPast,
    KeepsTracks,
    KeepsZonotope,
    SolvesProgrammes,
    WeighsShares,
)
from concord.nodes.faults.active import hangs, has_lost_clock, is_silent
from concord.nodes.faults.retries import failed_frames
from concord.nodes.faults.senders import spoken
from concord.nodes.inbox import (
    EARLY_CYCLES,
    MOST_EARLY,
    cut_short,
    file_early,
    hear,
    hear_late,
    last_early_cycle,
    let_in_overtaken,
    take_due,
)
from concord.nodes.messages import (
    Bid,
    CutShare,
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
from concord.nodes.node_state import (
    Completion,
    Inbox,
    NodeConfig,
    NodeState,
    Phase,
    Transition,
    count,
    counted,
)

# The page shows two; a weight is not computed with.
_WEIGHT_DECIMALS = 4


def estimate_of(config: NodeConfig, state: NodeState) -> Estimate:
    """Return the belief of a step, and what else the node's rule knows."""
    estimator, content = config.estimator, state.content
    belief, ages = estimator.belief(content), estimator.ages(content)
    generators = smoothed = smoothed_std = None
    if _has(type(estimator), KeepsZonotope):
        generators = cast(KeepsZonotope, estimator).generators(content)
    if _has(type(estimator), KeepsPast):
        smoothed, cov = cast(KeepsPast, estimator).smoothed(content)
        smoothed_std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    checks = _has(type(estimator), ChecksItself)
    weights = tracks = gap = None
    if _has(type(estimator), SolvesProgrammes):
        gap = cast(SolvesProgrammes, estimator).gap(content)
    if _has(type(estimator), KeepsTracks):
        tracks = cast(KeepsTracks, estimator).tracks(content)
    if _has(type(estimator), WeighsShares):
        weights = cast(WeighsShares, estimator).weights(content)
    return Estimate(
        config.index,
        state.step,
        to_wire(belief.mean),
        to_wire(pack_upper(belief.cov)),
        ages.tolist(),
        # By name: which was counted first depends on the clock in a process that joins late.
        dict(sorted(state.counters.items())),
        *(None if one is None else to_wire(one) for one in (generators, smoothed, smoothed_std)),
        suspect=checks and cast(ChecksItself, estimator).is_suspect(content),
        absent=tuple(sorted(state.absent)),
        weights=None if weights is None else to_wire(weights.round(_WEIGHT_DECIMALS)),
        tracks=tracks,
        gap=gap,
    )


@lru_cache
def _has(kind: type, protocol: type) -> bool:
    # Kept: to ask a protocol takes longer than to tell an estimate.
    return issubclass(kind, protocol)


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
        transition = TRANSITIONS[state.phase][type(event)]
        state = transition.handle(config, state, event, outbox)
    return advance(config, state, outbox), outbox


def awaited_neighbours(config: NodeConfig, state: NodeState) -> list[int]:
    """In phase SHARES: the neighbours whose shares are due and have not come, ascending."""
    cycle, came = state.cycle, state.inbox.shares
    missing = list(_due(config, state))
    if came:
        missing = [j for j in missing if (cycle, j) not in came]
    missing += cut_short(config, state)
    if not (missing and config.faults.are_active):
        return missing
    overtaken = state.inbox.overtaken
    return [
        j
        for j in missing
        if not overtaken.get((cycle, j)) and not is_silent(config.faults, state.step, cycle, j)
    ]


def is_complete(config: NodeConfig, state: NodeState) -> bool:
    """Whether the open group lacks nothing that is due."""
    return state.phase is Phase.SHARES and not awaited_neighbours(config, state)


def advance(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    """Make all transitions that are due by what has come; what to send goes to the outbox."""
    due = True
    while due:
        due = False
        for completion in COMPLETIONS[state.phase]:
            if completion.is_due(config, state):
                state = completion.go_on(config, state, outbox)
                due = True
                break
    return state


def has_changes(_config: NodeConfig, state: NodeState) -> bool:
    """Whether the heartbeat of the next step has come and brings changes."""
    heartbeat = state.inbox.measured.get(state.step + 1)
    return heartbeat is not None and bool(heartbeat.changes)


def has_heartbeat(_config: NodeConfig, state: NodeState) -> bool:
    """Whether the heartbeat of the next step has come."""
    return state.step + 1 in state.inbox.measured


def has_grant(_config: NodeConfig, state: NodeState) -> bool:
    """Whether the grant of the open group has come."""
    return (state.cycle, state.group) in state.inbox.grants


def has_all_shares(config: NodeConfig, state: NodeState) -> bool:
    """Whether all due shares of the open group have come, where no clock ends it."""
    return not config.timed and not awaited_neighbours(config, state)


def _stop_for_changes(
    _config: NodeConfig, state: NodeState, _outbox: list[NodeMessage]
) -> NodeState:
    return replace(state, phase=Phase.CHANGE)


def _open_step(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    return _open_group(config, _begin_step(config, state), outbox)


def _take_grant(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    grant = state.inbox.grants[state.cycle, state.group]
    state = replace(state, phase=Phase.SHARES, won=state.won + tuple(grant.winners))
    if config.index in grant.winners:
        return _send(config, state, outbox, grant.urgency_class(config.index))
    cut = grant.cut_shares.get(config.index)
    return state if cut is None else _send_cut(config, state, outbox, cut)


def _ignore(
    _config: NodeConfig, state: NodeState, _event: NodeEvent, _outbox: list[NodeMessage]
) -> NodeState:
    return state


def _hear(
    config: NodeConfig, state: NodeState, event: ShareHeard, _outbox: list[NodeMessage]
) -> NodeState:
    return hear(config, state, event)


def _note_gone(
    _config: NodeConfig, state: NodeState, event: Gone, _outbox: list[NodeMessage]
) -> NodeState:
    return replace(state, absent=state.absent | {event.node})


def _end_group(
    config: NodeConfig, state: NodeState, event: CycleClosed, outbox: list[NodeMessage]
) -> NodeState:
    if (event.cycle, event.group) != (state.cycle, state.group):
        return state
    return _close_group(config, state, outbox)


def _begin_step(config: NodeConfig, state: NodeState) -> NodeState:
    number = state.step + 1
    measured = dict(state.inbox.measured)
    content, failures = config.estimator.begin_step(state.content, measured.pop(number))
    inbox = replace(state.inbox, measured=measured)
    state = replace(state, step=number, content=content, inbox=inbox)
    state = count(state, *failures)
    return file_early(config, state) if state.inbox.early else state


def _open_group(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    """Begin a group: bid where there are slots to win, send where a slot is owned."""
    if state.inbox.late:
        state = hear_late(config, state)
    group = config.groups(state.cycle)[state.group]
    contenders: tuple[int, ...] = ()
    if group.dynamic_slots:
        contenders = contenders_left(config.schedule, state.cycle, state.won)
    if config.index in contenders:
        outbox.append(_bid(config, state))
    phase = Phase.GRANT if contenders else Phase.SHARES
    if phase is not state.phase:
        state = replace(state, phase=phase)
    if config.index in group.senders:
        state = _send(config, state, outbox)
    return state


def contenders_left(schedule: Schedule, cycle: int, won: tuple[int, ...]) -> tuple[int, ...]:
    """The nodes that may still ask for a dynamic slot in this cycle: no node sends twice."""
    served = won + schedule.static_senders(cycle)
    return tuple(node for node in schedule.contenders(cycle) if node not in served)


def _bid(config: NodeConfig, state: NodeState) -> Bid:
    faults = config.faults
    mute = hangs(faults, state.step, config.index)
    mute = mute or has_lost_clock(faults, state.cycle, config.index)
    bid = None if mute else config.estimator.bid(state.content)
    if bid is None:
        return Bid(config.index, state.cycle, None, 0, state.group)
    body_bytes = config.estimator.next_bytes(state.content)
    payloads = config.bus.payloads(config.index, state.cycle, body_bytes)
    return Bid(config.index, state.cycle, bid, sum(payloads), state.group)


def _send(
    config: NodeConfig, state: NodeState, outbox: list[NodeMessage], urgency_class: int = 0
) -> NodeState:
    faults, step, cycle = config.faults, state.step, state.cycle
    if faults.are_active and is_silent(faults, step, cycle, config.index):
        return count(state, "silent")
    content, body = config.estimator.compose(state.content)
    if faults.standing:
        body = spoken(faults, step, cycle, config.index, body)
    frames = config.bus.encode(config.index, cycle, body, urgency_class)
    outbox.extend(ShareSent(config.index, cycle, frame) for frame in frames)
    counters = counted(state.counters, *["sent" for _ in frames])
    if faults.standing and faults.equipment.retransmissions:
        failed = failed_frames(faults, step, cycle, config.index, frames, config.bus)
        counters = counted(counters, *["error frame"] * failed)
    return replace(state, content=content, counters=counters)


def _send_cut(
    config: NodeConfig, state: NodeState, outbox: list[NodeMessage], cut: CutShare
) -> NodeState:
    """Send the first frames of a share. The host knows that the others were not sent, so the node
    goes on as if it had said nothing."""
    first = len(outbox)
    after = _send(config, state, outbox, cut.urgency_class)
    if len(outbox) == first:
        return after
    del outbox[first + cut.frames :]
    return count(state, *["sent" for _ in outbox[first:]], "cut")


def _due(config: NodeConfig, state: NodeState) -> tuple[int, ...]:
    """Neighbours that send in the open group, as far as the node knows.

    Of a neighbour that is out, a share that came before its end counts.
    """
    due = config.groups(state.cycle)[state.group].neighbours
    if state.inbox.grants:
        grant = state.inbox.grants.get((state.cycle, state.group))
        granted = () if grant is None else grant.winners
        due = tuple(j for j in config.neighbours if j in due or j in granted)
    if not state.absent:
        return due
    came = state.inbox.shares
    return tuple(j for j in due if j not in state.absent or (state.cycle, j) in came)


def _close_group(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    if state.inbox.overtaken:
        state = let_in_overtaken(config, state)
    due = _due(config, state)
    # Without a grant no node knows the winners: a contender's frames then count as sent.
    usable = due if state.phase is Phase.SHARES else config.neighbours
    came, cycle = state.inbox.shares, state.cycle
    shares = tuple([came.get((cycle, j)) if j in usable else None for j in config.neighbours])
    missed = [j for j in due if came.get((cycle, j)) is None]
    content, failures = config.estimator.fuse(state.content, shares)
    state = count(replace(state, content=content), *failures, *["missed" for _ in missed])
    if state.group + 1 < len(config.groups(state.cycle)):
        return _open_group(config, replace(state, group=state.group + 1), outbox)
    return _close_cycle(config, state, outbox)


def _close_cycle(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    following = state.cycle + 1
    inbox = _forget_before(state, following)
    state = replace(state, cycle=following, group=0, won=(), inbox=inbox)
    if (following - config.first_cycle) % config.rounds:
        return _open_group(config, state, outbox)
    outbox.append(estimate_of(config, state))
    finished = state.step + 1 == config.steps
    return replace(state, phase=Phase.FINISHED if finished else Phase.MEASUREMENT)


def _keep_measured(
    _config: NodeConfig, state: NodeState, event: Measured, _outbox: list[NodeMessage]
) -> NodeState:
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


def _keep_grant(
    config: NodeConfig, state: NodeState, event: Grant, _outbox: list[NodeMessage]
) -> NodeState:
    key = (event.cycle, event.group)
    if key < (state.cycle, state.group) or key in state.inbox.grants:
        return count(state, "repeated grant")
    is_far = event.cycle > last_early_cycle(config, state)
    if is_far or len(state.inbox.grants) >= MOST_EARLY:
        return count(state, "rejected future")
    grants = {**state.inbox.grants, key: event}
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


_MEASUREMENT, _CHANGE, _GRANT, _SHARES, _FINISHED = Phase
_NEXT_GROUP = (_GRANT, _SHARES)
_AFTER_A_GROUP = (*_NEXT_GROUP, _MEASUREMENT, _FINISHED)


def _filed(phase: Phase) -> dict[type, Transition[NodeState, Phase]]:
    """Events that go to the inbox in every phase, and change no phase by themselves."""
    return {
        Measured: Transition(_keep_measured, (phase,)),
        ShareHeard: Transition(_hear, (phase,)),
        Grant: Transition(_keep_grant, (phase,)),
        Gone: Transition(_note_gone, (phase,)),
    }


TRANSITIONS: dict[Phase, dict[type, Transition[NodeState, Phase]]] = {
    _MEASUREMENT: {
        **_filed(_MEASUREMENT),
        CycleClosed: Transition(_ignore, (_MEASUREMENT,)),
    },
    _CHANGE: {**_filed(_CHANGE), CycleClosed: Transition(_ignore, (_CHANGE,))},
    _GRANT: {**_filed(_GRANT), CycleClosed: Transition(_end_group, _AFTER_A_GROUP)},
    _SHARES: {**_filed(_SHARES), CycleClosed: Transition(_end_group, _AFTER_A_GROUP)},
    _FINISHED: {**_filed(_FINISHED), CycleClosed: Transition(_ignore, (_FINISHED,))},
}
# A node leaves phase CHANGE by `concord.nodes.node_changes.apply`, which leads to MEASUREMENT.
COMPLETIONS: dict[Phase, tuple[Completion[NodeState, Phase], ...]] = {
    _MEASUREMENT: (
        Completion(has_changes, _stop_for_changes, (_CHANGE,)),
        Completion(has_heartbeat, _open_step, _NEXT_GROUP),
    ),
    _CHANGE: (),
    _GRANT: (Completion(has_grant, _take_grant, (_SHARES,)),),
    _SHARES: (Completion(has_all_shares, _close_group, _AFTER_A_GROUP),),
    _FINISHED: (),
}
