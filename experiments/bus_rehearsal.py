"""The bus of a scenario before it runs: what fits, what would fit instead, and a rehearsal.

In a rehearsal every contender asks in every contended cycle, the longer it was silent the more
urgently. A run asks less where it has a trigger, and bids by what has changed.
"""

from typing import NamedTuple

import msgspec
import numpy as np

from bus.arbitration import ArbiterState
from bus.dynamic_segment import walk
from bus.schedule import Schedule
from nodes.messages import Bid
from scenarios.build import build_plan
from scenarios.bus_plan import NO_CLUSTER, BusPlan, arbitrate
from scenarios.scenario import Scenario, check_ranges
from scenarios.setup import Setup, prepare

ALTERNATIVE_SCHEDULES = ("hybrid", "dynamic", "round-robin")
ANY_STRETCH = 1e9


class Rehearsal(NamedTuple):
    """What each node sent, in bytes of payload, and who asked for the dynamic segment; both
    (steps, rounds, N)."""

    payload_bytes: np.ndarray
    asked: np.ndarray

    @property
    def published(self) -> np.ndarray:
        """Who published (steps, rounds, N)."""
        return self.payload_bytes > 0

    @property
    def ages(self) -> np.ndarray:
        """Cycles since each node published, after each step (steps, N); -1 where it never did."""
        steps, rounds, nodes = self.published.shape
        cycles = np.arange(steps * rounds)[:, None]
        sent = np.where(self.published.reshape(-1, nodes), cycles, -1)
        last = np.maximum.accumulate(sent, axis=0)
        return np.where(last < 0, -1, cycles - last)[rounds - 1 :: rounds]


class Alternative(NamedTuple):
    """A bus that holds its schedule, and the setup it belongs to."""

    setup: Setup
    plan: BusPlan


def prepare_without_bus(scenario: Scenario) -> Setup:
    """The scenario worked out whether or not its cluster holds its schedule, and in time.

    Raises:
        ValueError: for any other mistake.
    """
    check_ranges(scenario)
    patient = msgspec.structs.replace(scenario, stretch=ANY_STRETCH)
    free = {"cluster": NO_CLUSTER, "schedule": "full", "occupancy": 1.0}
    try:
        setup = prepare(patient)
    except ValueError as refusal:
        try:
            setup = prepare(msgspec.structs.replace(patient, **free))
        except ValueError:
            raise refusal from None
    return msgspec.structs.replace(setup, scenario=scenario)


def changed(setup: Setup, **fields: object) -> Setup:
    """The setup with other choices about its bus."""
    scenario = msgspec.structs.replace(setup.scenario, **fields)
    return msgspec.structs.replace(setup, scenario=scenario)


def alternatives(setup: Setup) -> list[Alternative]:
    """Per schedule and number format the largest occupancy whose shares all fit, largest first."""
    numbers = dict.fromkeys((setup.scenario.number, "float32"))
    found = [
        _largest(changed(setup, number=number, schedule=schedule))
        for number in numbers
        for schedule in ALTERNATIVE_SCHEDULES
    ]
    fitting = [alternative for alternative in found if alternative is not None]
    return sorted(fitting, key=lambda one: -shares_per_cycle(one.plan.schedule))


def shares_per_cycle(schedule: Schedule) -> int:
    """Most shares that a schedule lets into a cycle."""
    return max(
        len(schedule.static_senders(cycle)) + schedule.dynamic_slots(cycle)
        for cycle in range(schedule.period)
    )


def dynamic_room(plan: BusPlan) -> int:
    """How many shares the dynamic segment holds whoever wins, up to what the schedule lets in."""
    contenders = sorted({node for row in plan.schedule.contender_table for node in row})
    wanted = min(max(plan.schedule.dynamic_slot_table), len(contenders))
    if plan.cluster is None or plan.table is None:
        return wanted
    # The worst case: the winners have the last IDs, and every slot before them counts by empty.
    requests = [plan.table.request(node, 0) for node in contenders]
    for count in range(wanted, 0, -1):
        if not walk(plan.cluster, requests[-count:]).waiting:
            return count
    return 0


def rehearse(setup: Setup, plan: BusPlan, steps: int) -> Rehearsal:
    """Go through so many steps of a schedule without filters."""
    scenario, schedule = setup.scenario, plan.schedule
    cycles = steps * scenario.rounds
    payload_bytes = np.zeros((cycles, scenario.nodes), dtype=np.int64)
    asked = np.zeros((cycles, scenario.nodes), dtype=bool)
    serve, state = arbitrate(scenario, plan), ArbiterState()
    silent = [0] * scenario.nodes
    for cycle in range(cycles):
        contenders = sorted(schedule.contenders(cycle))
        senders = schedule.static_senders(cycle)
        if contenders:
            bids = tuple(
                Bid(i, cycle, silent[i], _payload_bytes(plan, i, cycle)) for i in contenders
            )
            state, winners = serve(state, cycle, bids)
            asked[cycle, contenders] = True
            senders += winners
        for node in senders:
            payload_bytes[cycle, node] = _payload_bytes(plan, node, cycle)
        silent = [
            0 if sent else waited + 1
            for sent, waited in zip(payload_bytes[cycle], silent, strict=True)
        ]
    shape = (steps, scenario.rounds, scenario.nodes)
    return Rehearsal(payload_bytes.reshape(shape), asked.reshape(shape))


def _payload_bytes(plan: BusPlan, node: int, cycle: int) -> int:
    return sum(slot.payload_bytes for slot in plan.slots(node, cycle))


def _largest(setup: Setup) -> Alternative | None:
    """The largest occupancy that fits; fewer publishers never need more room."""
    nodes = setup.scenario.nodes
    best, low, high = None, 1, nodes
    while low <= high:
        middle = (low + high + 1) // 2
        tried = _fitting(changed(setup, occupancy=middle / nodes))
        if tried is None:
            high = middle - 1
        else:
            best, low = tried, middle + 1
    return best


def _fitting(setup: Setup) -> Alternative | None:
    try:
        plan = build_plan(setup)
    except ValueError:
        return None
    wanted = max(plan.schedule.dynamic_slot_table)
    return Alternative(setup, plan) if dynamic_room(plan) >= wanted else None
