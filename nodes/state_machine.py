"""One node of the network as a pure state machine: events in, messages out.

The story of a step: a `Measured` opens it; then come `rounds` communication cycles. In each the
node sends if the schedule (or the arbiter's grant) says so, waits for exactly the frames that are
due from its neighbours, and fuses; after the last it emits an `Estimate`. `CycleClosed` ends a
cycle with whatever has come.

This file never does I/O, reads a clock or draws a number, and never raises for a peer's fault: a
share that is late, early, repeated, missing or malformed is dropped, kept or counted here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from bus.publication import Slot
from bus.schedule import Schedule
from filters.linalg import pack_upper
from nodes.estimator import Content, Estimator, Rejected, Share
from nodes.link_state import PERFECT, LinkState, hears
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
from nodes.share import (
    CYCLE_COUNTS,
    fragments_of,
    payload_bytes,
    read_body,
    read_frame,
    to_frames,
)

# How many steps a neighbour's share may be ahead of us and still be kept: bounds the inbox. The
# world lets nobody run further ahead than its lead.
EARLY_STEPS = 8


class Phase(Enum):
    """What a node waits for."""

    MEASUREMENT = "measurement"
    GRANT = "grant"
    SHARES = "shares"
    FINISHED = "finished"


@dataclass(frozen=True)
class NodeConfig:
    """Everything a node knows before the start.

    `neighbours` ascend, as the weights do; `slots(node, cycle)` are those of a node's share;
    the cluster's cycle counter wraps at `cycle_counts`; `links` says which frames do not arrive.
    """

    index: int
    neighbours: tuple[int, ...]
    rounds: int
    steps: int
    schedule: Schedule
    slots: Callable[[int, int], tuple[Slot, ...]]
    estimator: Estimator
    cycle_counts: int = CYCLE_COUNTS
    links: LinkState = PERFECT


class Inbox(NamedTuple):
    """What has come before its time: heartbeats by step, grants by (cycle, group), shares and their
    parts by (cycle, sender). What the link has lost is None: nobody waits for it any more."""

    measured: dict[int, Measured]
    grants: dict[tuple[int, int], tuple[int, ...]]
    parts: dict[tuple[int, int], dict[int, bytes | None]]
    shares: dict[tuple[int, int], Share | None]


class NodeState(NamedTuple):
    """A node between two events.

    `step` is the last begun, `cycle` the one that is open or next, `group` its open part; `won` are
    the nodes that have had a dynamic slot in earlier parts of it.
    """

    phase: Phase
    step: int
    cycle: int
    group: int
    won: tuple[int, ...]
    content: Content
    inbox: Inbox
    counters: dict[str, int]


def initial_state(config: NodeConfig) -> NodeState:
    """The state before the first heartbeat."""
    content = config.estimator.start()
    return NodeState(Phase.MEASUREMENT, -1, 0, 0, (), content, Inbox({}, {}, {}, {}), {})


def step(
    config: NodeConfig, state: NodeState, event: NodeEvent
) -> tuple[NodeState, list[NodeMessage]]:
    """Take one event; returns the next state and what to send, in order."""
    outbox: list[NodeMessage] = []
    match event:
        case ShareHeard():
            state = _hear(config, state, event)
        case Measured():
            state = _keep_measured(state, event)
        case Grant():
            state = _keep_grant(state, event)
        case CycleClosed():
            is_open = state.phase in (Phase.GRANT, Phase.SHARES)
            if is_open and (event.cycle, event.group) == (state.cycle, state.group):
                state = _close_group(config, state, outbox)
    return _advance(config, state, outbox), outbox


def awaited_neighbour(config: NodeConfig, state: NodeState) -> int | None:
    """In phase SHARES: the first neighbour whose share is due and has not come."""
    for neighbour in _due(config, state):
        if (state.cycle, neighbour) not in state.inbox.shares:
            return neighbour
    return None


def _advance(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    """Go on as far as what has come allows."""
    while True:
        if state.phase is Phase.MEASUREMENT and state.step + 1 in state.inbox.measured:
            state = _begin_step(config, state)
            state = _open_group(config, state, outbox)
        elif state.phase is Phase.GRANT and (state.cycle, state.group) in state.inbox.grants:
            winners = state.inbox.grants[state.cycle, state.group]
            state = state._replace(phase=Phase.SHARES, won=state.won + winners)
            if config.index in winners:
                state = _send(config, state, outbox)
        elif state.phase is Phase.SHARES and awaited_neighbour(config, state) is None:
            state = _close_group(config, state, outbox)
        else:
            return state


def _begin_step(config: NodeConfig, state: NodeState) -> NodeState:
    number = state.step + 1
    measured = dict(state.inbox.measured)
    content, troubles = config.estimator.begin_step(state.content, measured.pop(number))
    state = state._replace(
        step=number, content=content, inbox=state.inbox._replace(measured=measured)
    )
    return _count(state, *troubles)


def _open_group(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    """Begin a part of a cycle: bid where there are slots to win, send where a slot is owned."""
    group = config.schedule.groups(state.cycle)[state.group]
    contenders = contenders_left(config.schedule, state.cycle, state.won)
    contest = group.dynamic_slots > 0 and bool(contenders)
    if contest and config.index in contenders:
        outbox.append(_bid(config, state))
    state = state._replace(phase=Phase.GRANT if contest else Phase.SHARES)
    if config.index in group.senders:
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
    bid = config.estimator.bid(state.content)
    return Bid(config.index, state.cycle, bid, payload_bytes(body, slots), state.group)


def _send(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    content, body = config.estimator.compose(state.content)
    slots = config.slots(config.index, state.cycle)
    frames = to_frames(body, state.cycle, slots, config.cycle_counts)
    outbox.extend(ShareSent(config.index, state.cycle, frame) for frame in frames)
    return _count(state._replace(content=content), *["sent"] * len(frames))


def _due(config: NodeConfig, state: NodeState) -> tuple[int, ...]:
    """Neighbours that send in the open part of the cycle, as far as the node knows."""
    senders = config.schedule.groups(state.cycle)[state.group].senders
    senders += state.inbox.grants.get((state.cycle, state.group), ())
    return tuple(j for j in config.neighbours if j in senders)


def _close_group(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    due = _due(config, state)
    # Without a grant nobody knows who won: what came from a contender then stands as sent.
    usable = due if state.phase is Phase.SHARES else config.neighbours
    came = state.inbox.shares
    shares = tuple(came.get((state.cycle, j)) if j in usable else None for j in config.neighbours)
    missed = sum(came.get((state.cycle, j)) is None for j in due)
    content, troubles = config.estimator.fuse(state.content, shares)
    state = _count(state._replace(content=content), *troubles, *["missed"] * missed)
    if state.group + 1 < len(config.schedule.groups(state.cycle)):
        return _open_group(config, state._replace(group=state.group + 1), outbox)
    return _close_cycle(config, state, outbox)


def _close_cycle(config: NodeConfig, state: NodeState, outbox: list[NodeMessage]) -> NodeState:
    following = state.cycle + 1
    inbox = _forget_before(state, following)
    state = state._replace(cycle=following, group=0, won=(), inbox=inbox)
    if state.cycle % config.rounds:
        return _open_group(config, state, outbox)
    outbox.append(_estimate(config, state))
    finished = state.step + 1 == config.steps
    return state._replace(phase=Phase.FINISHED if finished else Phase.MEASUREMENT)


def _estimate(config: NodeConfig, state: NodeState) -> Estimate:
    belief = config.estimator.belief(state.content)
    ages = config.estimator.ages(state.content)
    return Estimate(
        config.index,
        state.step,
        to_wire(belief.mean),
        to_wire(pack_upper(belief.cov)),
        ages.tolist(),
        state.counters,
    )


def _hear(config: NodeConfig, state: NodeState, event: ShareHeard) -> NodeState:
    """File a frame under its cycle and sender, or count why not."""
    if event.sender not in config.neighbours:
        return _count(state, "rejected stranger")
    try:
        frame_id, cycle, cycle_count, data = read_frame(event.frame)
        count = fragments_of(data)
    except Rejected as rejected:
        return _count(state, f"rejected {rejected.reason}")
    if cycle % config.cycle_counts != cycle_count:
        return _count(state, "rejected cycle-count")
    if cycle < state.cycle:
        return _count(state, "late")
    if cycle > state.cycle + EARLY_STEPS * config.rounds:
        return _count(state, "rejected future")
    schedule = config.schedule
    if event.sender not in schedule.static_senders(cycle) + schedule.contenders(cycle):
        return _count(state, "rejected unscheduled")
    frame_ids = [slot.frame_id for slot in config.slots(event.sender, cycle)]
    # A share takes the first of its sender's slots, as many as it needs.
    if frame_id not in frame_ids[:count]:
        return _count(state, "rejected wrong-slot")
    key = (cycle, event.sender)
    parts = state.inbox.parts.get(key, {})
    if key in state.inbox.shares or frame_id in parts:
        return _count(state, "repeated")
    # The transport brings what the simulated link loses, so that nobody waits for it in vain.
    arrives = config.links.perfect or hears(
        config.links,
        cycle // config.rounds,
        cycle,
        event.sender,
        config.index,
        frame_ids.index(frame_id),
    )
    parts = {**parts, frame_id: data if arrives else None}
    if not arrives:
        state = _count(state, "lost")
    if len(parts) == count:
        return _complete(config, state, key, list(parts.values()))
    return state._replace(inbox=state.inbox._replace(parts={**state.inbox.parts, key: parts}))


def _complete(
    config: NodeConfig, state: NodeState, key: tuple[int, int], fragments: list[bytes | None]
) -> NodeState:
    """All frames of a share are there or lost: keep what it means; None marks one of no use."""
    share = None
    whole = [fragment for fragment in fragments if fragment is not None]
    if len(whole) == len(fragments):
        try:
            share = config.estimator.accept(read_body(whole))
            state = _count(state, "heard")
        except Rejected as rejected:
            state = _count(state, f"rejected {rejected.reason}")
    parts = {k: v for k, v in state.inbox.parts.items() if k != key}
    shares = {**state.inbox.shares, key: share}
    return state._replace(inbox=state.inbox._replace(parts=parts, shares=shares))


def _keep_measured(state: NodeState, event: Measured) -> NodeState:
    if event.step <= state.step or event.step in state.inbox.measured:
        return _count(state, "repeated measured")
    measured = {**state.inbox.measured, event.step: event}
    return state._replace(inbox=state.inbox._replace(measured=measured))


def _keep_grant(state: NodeState, event: Grant) -> NodeState:
    key = (event.cycle, event.group)
    if key < (state.cycle, state.group) or key in state.inbox.grants:
        return _count(state, "repeated grant")
    grants = {**state.inbox.grants, key: tuple(event.winners)}
    return state._replace(inbox=state.inbox._replace(grants=grants))


def _forget_before(state: NodeState, cycle: int) -> Inbox:
    inbox = state.inbox
    return inbox._replace(
        grants={key: winners for key, winners in inbox.grants.items() if key[0] >= cycle},
        parts={key: parts for key, parts in inbox.parts.items() if key[0] >= cycle},
        shares={key: share for key, share in inbox.shares.items() if key[0] >= cycle},
    )


def _count(state: NodeState, *names: str) -> NodeState:
    if not names:
        return state
    counters = dict(state.counters)
    for name in names:
        counters[name] = counters.get(name, 0) + 1
    return state._replace(counters=counters)
