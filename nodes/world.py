"""The world as a pure state machine: the plant moves, its sensors read, the bus arbiter grants.

The world sends each node its readings (the heartbeat of a step) and hears every node's estimate. It
runs at most `lead` steps ahead of the slowest estimate: 1 where a controller closes the loop
through the estimates, more where nothing flows back and the network need not wait for the round
trip. It never releases more than the driver allows, and every change is made while nothing is under
way (`nodes/world_changes.py`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from msgspec import UNSET

from bus.schedule import Schedule
from nodes.changes import UNCHANGED, Change, Event, Gone, Joined, Standing, after, without_return
from nodes.faults import HEALTHY, Faults, hangs
from nodes.messages import (
    Array,
    Bid,
    BidsClosed,
    Estimate,
    Grant,
    Measured,
    StepClosed,
    Truth,
    WorldEvent,
    WorldMessage,
    from_wire,
    to_wire,
)
from nodes.sensor_faults import delivered as delivered_by_faulty
from nodes.state_machine import contenders_left


class Draws(Protocol):
    """The randomness of one run: process (steps, q) and measurement (steps, ...), for `Plant`."""

    @property
    def process(self) -> Array: ...

    @property
    def measurement(self) -> Array: ...


class Plant(Protocol):
    """The truth and what its sensors deliver."""

    def advance(self, state: Array, control: Array | None, noise: Array, step: int) -> Array:
        """The state (..., n) at `step + 1` from the state at `step`."""
        ...

    def observe(self, state: Array, noise: Array, step: int) -> Array:
        """What the sensors deliver (..., nodes, readings, d); NaN where a node sees nothing."""
        ...


class Controller(NamedTuple):
    """What drives the plant: `law(state (n,), memory, step) -> (control (p,), memory)`.

    `node` is whose estimate it believes; None lets it see the true state.
    """

    law: Callable[[Array, Any, int], tuple[Array, Any]]
    memory: Any
    node: int | None


class Delivery(NamedTuple):
    """What lies between sensors and their nodes, such as a measurement bus at each node.

    `transmit(memory, readings (nodes, r, d), step) -> (memory, delivered (nodes, r, d))`.
    """

    transmit: Callable[[Any, Array, int], tuple[Any, Array]]
    memory: Any


def _exact(readings: Array) -> Array:
    return np.zeros_like(readings)


Arbitrate = Callable[[Any, int, tuple[Bid, ...]], tuple[Any, tuple[int, ...]]]


@dataclass(frozen=True)
class WorldConfig:
    """Everything the world knows before the start.

    `arbitrate(state, cycle, bids) -> (state, winners)` serves the dynamic segment; `neighbours` are
    whom each node hears; `faults` decide what is wrong; `spread` gives the standard deviations
    (nodes, r, d) of readings of that shape. The configuration holds from `first_step` on, whose
    cycles begin at `first_cycle`; `rebuild(standing)` makes the one that goes with other settings.
    """

    plant: Plant
    initial_state: Array
    draws: Draws
    nodes: int
    steps: int
    rounds: int
    lead: int
    schedule: Schedule
    arbitrate: Arbitrate
    arbiter_state: Any
    controller: Controller | None
    states: int
    delivery: Delivery | None = None
    neighbours: Sequence[Sequence[int]] = ()
    first_step: int = 0
    first_cycle: int = 0
    rebuild: "Callable[[Standing], WorldConfig] | None" = None
    faults: Faults = HEALTHY
    spread: Callable[[Array], Array] = _exact

    def cycle_of(self, step: int) -> int:
        """The first communication cycle of a step that is not before `first_step`."""
        return self.first_cycle + (step - self.first_step) * self.rounds


class WorldState(NamedTuple):
    """The world between two events.

    `released` steps have been sent, of at most `limit`; `completed` ones estimated by all members,
    which left `latest`; `since` is the first step of who has joined. `announced` changes hold from
    the step that is released next; `delivered` (nodes, r, d) is what the sensors did in the step
    that was released last.
    """

    released: int
    completed: int
    truth: Array
    memory: Any
    control: Array | None
    estimates: dict[int, dict[int, Estimate]]
    next_cycle: int
    next_group: int
    won: tuple[int, ...]
    bids: dict[tuple[int, int], dict[int, Bid]]
    arbiter: Any
    delivery: Any
    limit: int
    latest: dict[int, Estimate]
    standing: Standing
    announced: tuple[Change, ...]
    delivered: Array | None
    since: dict[int, int]

    @property
    def idle(self) -> bool:
        """Nothing is under way: all members have estimated every step that was released."""
        return self.completed == self.released


def begin(config: WorldConfig) -> WorldState:
    """The state before the first heartbeats."""
    memory = config.controller.memory if config.controller else None
    delivery = config.delivery.memory if config.delivery else None
    state = WorldState(
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
        arbiter=config.arbiter_state,
        delivery=delivery,
        limit=0,
        latest={},
        standing=UNCHANGED,
        announced=(),
        delivered=None,
        since={},
    )
    return skip_quiet_cycles(config, state)


def allow(
    config: WorldConfig, state: WorldState, limit: int
) -> tuple[WorldState, list[WorldMessage]]:
    """Let the world release steps up to before `limit`; a smaller one holds it back."""
    outbox: list[WorldMessage] = []
    return _release(config, state._replace(limit=limit), outbox), outbox


def members(config: WorldConfig, state: WorldState) -> list[int]:
    """The nodes that are not out, ascending."""
    return [node for node in range(config.nodes) if node not in state.standing.absent]


def step(
    config: WorldConfig, state: WorldState, event: WorldEvent
) -> tuple[WorldState, list[WorldMessage]]:
    """Take one event; returns the next state and what to send, in order."""
    outbox: list[WorldMessage] = []
    match event:
        case Estimate():
            if not _is_sound(config, state, event):
                return state, outbox
            heard = {**state.estimates.get(event.step, {}), event.node: event}
            state = state._replace(estimates={**state.estimates, event.step: heard})
            state = _complete(config, state, outbox)
        case Bid() if _is_open(config, state, event):
            contest = (event.cycle, event.group)
            asked = {**state.bids.get(contest, {}), event.node: event}
            state = state._replace(bids={**state.bids, contest: asked})
            state = _grant(config, state, outbox)
        case Gone():
            state = _without(config, state, event, outbox)
        case BidsClosed():
            state = _grant(config, state, outbox, (event.cycle, event.group))
        case StepClosed():
            state = _complete(config, state, outbox, event.step)
    return state, outbox


def _is_open(config: WorldConfig, state: WorldState, bid: Bid) -> bool:
    """Whether a bid is of one of the nodes, and for a contest of the steps that are under way."""
    return (
        bid.node < config.nodes
        and (state.next_cycle, state.next_group) <= (bid.cycle, bid.group)
        and bid.cycle < config.cycle_of(state.released)
        and bid.group < len(config.schedule.groups(bid.cycle))
    )


def _is_sound(config: WorldConfig, state: WorldState, estimate: Estimate) -> bool:
    """Whether an estimate is of somebody who takes part, of an open step and of the right form."""
    size = config.states
    return (
        estimate.node < config.nodes
        and estimate.node not in state.standing.absent
        and state.completed <= estimate.step < state.released
        and len(estimate.mean) == size
        and len(estimate.cov) == size * (size + 1) // 2
    )


def finished(config: WorldConfig, state: WorldState) -> bool:
    """Every node has estimated every step."""
    return state.completed == config.steps


def awaits_bids(config: WorldConfig, state: WorldState) -> bool:
    """The network cannot go on before the contenders of the next contended cycle have bid; else
    the world waits for estimates alone."""
    return state.next_cycle < config.cycle_of(state.released)


def _without(
    config: WorldConfig, state: WorldState, gone: Gone, outbox: list[WorldMessage]
) -> WorldState:
    """Nobody waits for a node that is gone, from the first step on that it has not estimated."""
    if gone.node in state.standing.absent:
        return state
    step = state.completed
    while gone.node in state.estimates.get(step, ()):
        step += 1
    outbox += [gone, Event(step, gone)]
    state = state._replace(standing=after(state.standing, step, gone))
    state = state._replace(announced=without_return(state.announced, gone.node))
    return _complete(config, _grant(config, state, outbox), outbox)


def _complete(
    config: WorldConfig, state: WorldState, outbox: list[WorldMessage], closed: int = -1
) -> WorldState:
    """Go on from each step that all have estimated who took part, or that is `closed`."""
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
        # A step that nobody has estimated leaves what was believed before.
        latest = came or state.latest
        state = state._replace(completed=number + 1, estimates=estimates, latest=latest)
        state = _release(config, state, outbox)
    return state


def _release(
    config: WorldConfig,
    state: WorldState,
    outbox: list[WorldMessage],
) -> WorldState:
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
        # A node that joins was told with its welcome what holds.
        joined = {change.node for change in state.announced if isinstance(change, Joined)}
        outbox.extend(
            Measured(
                node,
                number,
                to_wire(delivered[node]),
                control,
                () if node in joined else state.announced,
            )
            for node in members(config, state)
        )
        state = state._replace(released=number + 1, announced=())
    # Where all who might contend are out, nobody's bid will ask for the grant that others await.
    return _grant(config, state, outbox)


def _read_sensors(config: WorldConfig, state: WorldState) -> Array:
    """What the sensors of all nodes deliver (nodes, r, d) in the step that is released next."""
    step = state.released
    readings = config.plant.observe(state.truth, config.draws.measurement[step], step)
    faults = config.faults.stand(state.standing)
    if not faults.standing:
        return readings
    return delivered_by_faulty(faults, step, readings, state.delivered, config.spread(readings))


def _advance(config: WorldConfig, state: WorldState) -> WorldState:
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


def skip_quiet_cycles(config: WorldConfig, state: WorldState) -> WorldState:
    """Go on to the next part of a cycle in which somebody may contend."""
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
    config: WorldConfig,
    state: WorldState,
    outbox: list[WorldMessage],
    closed: tuple[int, int] = (-1, 0),
) -> WorldState:
    """Serve every contest whose bids are complete, or that is `closed`, in order."""
    while True:
        contest = (state.next_cycle, state.next_group)
        bids = state.bids.get(contest, {})
        left = contenders_left(config.schedule, state.next_cycle, state.won)
        contenders = [node for node in left if node not in state.standing.absent]
        unheard = [node for node in contenders if node not in bids]
        if not awaits_bids(config, state) or (unheard and contest > closed):
            return state
        # In node order: who asked first on the wire must not matter.
        requests = tuple(bids[node] for node in sorted(contenders) if node in bids)
        arbiter, winners = state.arbiter, ()
        if requests:
            arbiter, winners = config.arbitrate(arbiter, state.next_cycle, requests)
        grant = Grant(state.next_cycle, list(winners), state.next_group, unheard or UNSET)
        outbox.append(grant)
        rest = {key: asked for key, asked in state.bids.items() if key != contest}
        state = state._replace(
            arbiter=arbiter, bids=rest, next_group=state.next_group + 1, won=state.won + winners
        )
        state = skip_quiet_cycles(config, state)
