"""The environment as a pure state machine: the plant moves, sensors read, the bus arbiter grants.

The environment sends each node its readings (the heartbeat of a step) and hears every node's
estimate. It runs at most `lead` steps ahead of the slowest estimate: 1 where a controller closes
the loop through the estimates, more where nothing flows back. It never releases more steps than
the run controller allows. Every change is made while nothing is under way
(`nodes/environment_changes.py`). `TRANSITIONS` says what each event does in each phase.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import UNSET

from concord.bus.arbitration import NO_BID, ArbiterState, begin_arbitration
from concord.nodes.changes import UNCHANGED, Event, Gone, after, since_return, without_return
from concord.nodes.environment_state import EnvironmentConfig, EnvironmentPhase, EnvironmentState
from concord.nodes.faults.active import hangs
from concord.nodes.faults.sensors import delivered as delivered_by_faulty
from concord.nodes.messages import (
    Allowed,
    Bid,
    BidsClosed,
    CutShare,
    EnvironmentEvent,
    EnvironmentMessage,
    Estimate,
    Grant,
    Measured,
    StepClosed,
    Truth,
    from_wire,
    to_wire,
)
from concord.nodes.node import contenders_left
from concord.nodes.node_state import Transition

# A float64 holds every whole number up to here.
_LARGEST_BID = 2**53


def begin(config: EnvironmentConfig) -> EnvironmentState:
    """The state before the first heartbeats."""
    memory = config.controller.memory if config.controller else None
    delivery = config.delivery.memory if config.delivery else None
    state = EnvironmentState(
        released=0,
        completed=0,
        truth=config.initial_state,
        memory=memory,
        control=None,
        estimates={},
        next_cycle=0,
        next_group=0,
        won=(),
        bids={},
        arbiter=begin_arbitration(config.nodes),
        delivery=delivery,
        limit=0,
        latest={},
        standing=UNCHANGED,
        announced=(),
        delivered=None,
        since={},
    )
    return skip_quiet_cycles(config, state)


def members(config: EnvironmentConfig, state: EnvironmentState) -> list[int]:
    """The nodes that are not out, ascending."""
    return [node for node in range(config.nodes) if node not in state.standing.absent]


def step(
    config: EnvironmentConfig, state: EnvironmentState, event: EnvironmentEvent
) -> tuple[EnvironmentState, list[EnvironmentMessage]]:
    """Take one event; returns the next state and what to send, in order."""
    outbox: list[EnvironmentMessage] = []
    transition = TRANSITIONS[phase_of(config, state)][type(event)]
    return transition.handle(config, state, event, outbox), outbox


def phase_of(config: EnvironmentConfig, state: EnvironmentState) -> EnvironmentPhase:
    """Tell the phase of a state: the events that the environment waits for."""
    if finished(config, state):
        return EnvironmentPhase.FINISHED
    if state.idle:
        return EnvironmentPhase.HELD
    if awaits_bids(config, state):
        return EnvironmentPhase.BIDS
    return EnvironmentPhase.ESTIMATES


def _ignore(
    _config: EnvironmentConfig,
    state: EnvironmentState,
    _event: EnvironmentEvent,
    _outbox: list[EnvironmentMessage],
) -> EnvironmentState:
    return state


def _allow(
    config: EnvironmentConfig,
    state: EnvironmentState,
    event: Allowed,
    outbox: list[EnvironmentMessage],
) -> EnvironmentState:
    return _release(config, state._replace(limit=event.limit), outbox)


def _take_estimate(
    config: EnvironmentConfig,
    state: EnvironmentState,
    event: Estimate,
    outbox: list[EnvironmentMessage],
) -> EnvironmentState:
    if not _is_sound(config, state, event):
        return state
    heard = {**state.estimates.get(event.step, {}), event.node: event}
    state = state._replace(estimates={**state.estimates, event.step: heard})
    return _complete(config, state, outbox)


def _take_bid(
    config: EnvironmentConfig,
    state: EnvironmentState,
    event: Bid,
    outbox: list[EnvironmentMessage],
) -> EnvironmentState:
    if not _is_open(config, state, event):
        return state
    contest = (event.cycle, event.group)
    asked = {**state.bids.get(contest, {}), event.node: event}
    return _grant(config, state._replace(bids={**state.bids, contest: asked}), outbox)


def _close_bids(
    config: EnvironmentConfig,
    state: EnvironmentState,
    event: BidsClosed,
    outbox: list[EnvironmentMessage],
) -> EnvironmentState:
    return _grant(config, state, outbox, (event.cycle, event.group))


def _close_step(
    config: EnvironmentConfig,
    state: EnvironmentState,
    event: StepClosed,
    outbox: list[EnvironmentMessage],
) -> EnvironmentState:
    return _complete(config, state, outbox, event.step)


def _is_open(config: EnvironmentConfig, state: EnvironmentState, bid: Bid) -> bool:
    """Whether a bid is of one of the nodes, and for a contest of the steps that are under way."""
    return (
        bid.node < config.nodes
        and (state.next_cycle, state.next_group) <= (bid.cycle, bid.group)
        and bid.cycle < config.cycle_of(state.released)
        and bid.group < len(config.schedule.groups(bid.cycle))
    )


def _is_sound(config: EnvironmentConfig, state: EnvironmentState, estimate: Estimate) -> bool:
    """Return whether an estimate is of a present node, of an open step and of the right form."""
    size = config.states
    return (
        estimate.node < config.nodes
        and estimate.node not in state.standing.absent
        and state.completed <= estimate.step < state.released
        and len(estimate.mean) == size
        and len(estimate.cov) == size * (size + 1) // 2
    )


def finished(config: EnvironmentConfig, state: EnvironmentState) -> bool:
    """Every node has estimated every step."""
    return state.completed == config.steps


def awaits_bids(config: EnvironmentConfig, state: EnvironmentState) -> bool:
    """The network cannot go on before the contenders of the next contended cycle have bid; else
    the environment waits for estimates alone."""
    return state.next_cycle < config.cycle_of(state.released)


def _drop_node(
    config: EnvironmentConfig, state: EnvironmentState, gone: Gone, outbox: list[EnvironmentMessage]
) -> EnvironmentState:
    """Wait no longer for a node that is gone, from the first step on that it has not estimated."""
    if gone.node in state.standing.absent:
        return state
    step = state.completed
    while gone.node in state.estimates.get(step, ()):
        step += 1
    outbox += [gone, Event(step, gone)]
    state = state._replace(standing=after(state.standing, step, gone))
    told = (*without_return(state.announced, gone.node), Gone(gone.node, step))
    state = state._replace(announced=told)
    return _complete(config, _grant(config, state, outbox), outbox)


def _complete(
    config: EnvironmentConfig,
    state: EnvironmentState,
    outbox: list[EnvironmentMessage],
    closed: int = -1,
) -> EnvironmentState:
    """Go on from each step that all participants have estimated, or that is `closed`."""
    # Fewer are not enough, whoever they are: mostly that is all there is to know.
    least = config.nodes - len(state.standing.absent) - len(state.since)
    while state.completed < state.released:
        number = state.completed
        came = state.estimates.get(number, {})
        if len(came) < least and number > closed:
            break
        expected = [i for i in members(config, state) if state.since.get(i, 0) <= number]
        whole = bool(expected) and all(node in came for node in expected)
        if not whole and number > closed:
            break
        estimates = {
            step: heard for step, heard in state.estimates.items() if step > state.completed
        }
        # A step without any estimate keeps the beliefs of the step before.
        latest = came or state.latest
        state = state._replace(completed=number + 1, estimates=estimates, latest=latest)
        state = _release(config, state, outbox)
    return state


def _release(
    config: EnvironmentConfig,
    state: EnvironmentState,
    outbox: list[EnvironmentMessage],
) -> EnvironmentState:
    """Move the plant on and send heartbeats, as far as the lead over the estimates allows."""
    while state.released < min(config.steps, state.limit, state.completed + config.lead):
        if state.released > 0:
            state = _advance(config, state)
        number = state.released
        outbox.append(Truth(number, to_wire(state.truth)))
        delivered = _read_sensors(config, state)
        state = state._replace(delivered=delivered)
        if config.delivery is not None:
            delivery, delivered = config.delivery.transmit(state.delivery, delivered, number)
            state = state._replace(delivery=delivery)
        control = None if state.control is None else state.control.tolist()
        outbox.extend(
            Measured(
                node,
                number,
                to_wire(delivered[node]),
                control,
                since_return(state.announced, node),
            )
            for node in members(config, state)
        )
        state = state._replace(released=number + 1, announced=())
    # Where all contenders are out, no bid will ask for the grant that others await.
    return _grant(config, state, outbox)


def _read_sensors(config: EnvironmentConfig, state: EnvironmentState) -> np.ndarray:
    """Read the sensors of all nodes (nodes, r, d) in the step that is released next."""
    step = state.released
    readings = config.plant.observe(state.truth, config.draws.measurement[step], step)
    faults = config.faults.stand(state.standing)
    if not faults.standing:
        return readings
    return delivered_by_faulty(faults, step, readings, state.delivered, config.spread(readings))


def _advance(config: EnvironmentConfig, state: EnvironmentState) -> EnvironmentState:
    last = state.released - 1
    if config.controller is not None:
        law, _, node = config.controller
        last_known = node is None or state.completed == state.released
        assert last_known, "a loop through the estimates needs lead = 1"
        # A node that is out or stands still leaves the actuator where it was.
        hung = node is not None and hangs(config.faults.stand(state.standing), last, node)
        if node is None or (node in state.latest and not hung):
            seen = state.truth if node is None else from_wire(state.latest[node].mean)
            control, memory = law(seen, state.memory, last)
            state = state._replace(control=control, memory=memory)
    noise = config.draws.process[last]
    return state._replace(truth=config.plant.advance(state.truth, state.control, noise, last))


def skip_quiet_cycles(config: EnvironmentConfig, state: EnvironmentState) -> EnvironmentState:
    """Go on to the next group in which a node may contend."""
    cycle, group, won = state.next_cycle, state.next_group, state.won
    while cycle < config.cycle_of(config.steps):
        groups = config.schedule.groups(cycle)
        contested = (
            number
            for number in range(group, len(groups))
            if groups[number].dynamic_slots and contenders_left(config.schedule, cycle, won)
        )
        group = next(contested, -1)
        if group >= 0:
            break
        cycle, group, won = cycle + 1, 0, ()
    return state._replace(next_cycle=cycle, next_group=max(group, 0), won=won)


def _grant(
    config: EnvironmentConfig,
    state: EnvironmentState,
    outbox: list[EnvironmentMessage],
    closed: tuple[int, int] = (-1, 0),
) -> EnvironmentState:
    """Serve every contest whose bids are complete, or that is `closed`, in order."""
    while True:
        contest = (state.next_cycle, state.next_group)
        bids = state.bids.get(contest, {})
        left = contenders_left(config.schedule, state.next_cycle, state.won)
        contenders = [node for node in left if node not in state.standing.absent]
        unheard = [node for node in contenders if node not in bids]
        if not awaits_bids(config, state) or (unheard and contest > closed):
            return state
        # In node order: the order of arrival on the wire must not matter.
        requests = [bids[node] for node in sorted(contenders) if node in bids]
        arbiter, grant = _award(config, state, contest, requests, unheard)
        outbox.append(grant)
        rest = {key: asked for key, asked in state.bids.items() if key != contest}
        number, won = state.next_group + 1, state.won + tuple(grant.winners)
        state = state._replace(arbiter=arbiter, bids=rest, next_group=number, won=won)
        state = skip_quiet_cycles(config, state)


def _award(
    config: EnvironmentConfig,
    state: EnvironmentState,
    contest: tuple[int, int],
    requests: Sequence[Bid],
    unheard: list[int],
) -> tuple[ArbiterState, Grant]:
    """Return the arbiter's memory, and the grant of a contest."""
    nodes = [request.node for request in requests]
    # A peer may bid any number: what is beyond all bids is as urgent as can be.
    bids = [
        NO_BID if request.bid is None else min(max(request.bid, 0), _LARGEST_BID)
        for request in requests
    ]
    awards = config.bus.arbitrate(
        state.arbiter,
        *contest,
        nodes,
        np.array(bids, dtype=np.int64),
        lambda: np.array([request.payload_bytes for request in requests], dtype=np.int64),
    )
    winners = [node for node, won in zip(nodes, awards.wins.tolist(), strict=True) if won]
    classes = awards.classes[awards.wins].tolist()
    cut = [CutShare(*one) for one in awards.cut_shares(nodes)]
    told = (unheard or UNSET, classes if any(classes) else UNSET, cut or UNSET)
    return awards.state, Grant(contest[0], winners, contest[1], *told)


_HELD, _BIDS, _ESTIMATES, _FINISHED = EnvironmentPhase
_ANY_BUT_BIDS = (_ESTIMATES, _HELD, _FINISHED)
# The lead may be more than one step: a completed step releases the next while others are under way.
TRANSITIONS: dict[EnvironmentPhase, dict[type, Transition[EnvironmentState, EnvironmentPhase]]] = {
    _HELD: {
        Allowed: Transition(_allow, (_HELD, _BIDS, _ESTIMATES)),
        Estimate: Transition(_ignore, (_HELD,)),
        # Steps that were closed by force may leave contests open.
        Bid: Transition(_take_bid, (_HELD,)),
        BidsClosed: Transition(_close_bids, (_HELD,)),
        StepClosed: Transition(_ignore, (_HELD,)),
        Gone: Transition(_drop_node, (_HELD,)),
    },
    _BIDS: {
        Allowed: Transition(_allow, (_BIDS,)),
        Estimate: Transition(_take_estimate, (_BIDS, _HELD, _FINISHED)),
        Bid: Transition(_take_bid, (_BIDS, _ESTIMATES)),
        BidsClosed: Transition(_close_bids, (_BIDS, _ESTIMATES)),
        StepClosed: Transition(_close_step, (_BIDS, _HELD, _FINISHED)),
        Gone: Transition(_drop_node, (_BIDS, *_ANY_BUT_BIDS)),
    },
    _ESTIMATES: {
        Allowed: Transition(_allow, (_ESTIMATES, _BIDS)),
        Estimate: Transition(_take_estimate, (_BIDS, *_ANY_BUT_BIDS)),
        Bid: Transition(_ignore, (_ESTIMATES,)),
        BidsClosed: Transition(_ignore, (_ESTIMATES,)),
        StepClosed: Transition(_close_step, (_BIDS, *_ANY_BUT_BIDS)),
        Gone: Transition(_drop_node, (_BIDS, *_ANY_BUT_BIDS)),
    },
    _FINISHED: {
        Allowed: Transition(_ignore, (_FINISHED,)),
        Estimate: Transition(_ignore, (_FINISHED,)),
        Bid: Transition(_ignore, (_FINISHED,)),
        BidsClosed: Transition(_ignore, (_FINISHED,)),
        StepClosed: Transition(_ignore, (_FINISHED,)),
        Gone: Transition(_drop_node, (_FINISHED,)),
    },
}
