"""The bus of a scenario before it runs: what fits, what would fit instead, and a rehearsal.

In a rehearsal every contender asks in every contended cycle, the longer it was silent the more
urgently. A run asks less where it has a trigger, and bids by what has changed.
"""

from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np

from concord.bus.arbitration import UrgencyClasses, begin_arbitration
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.bus.schedule import Schedule
from concord.results.bus.sent_shares import SentShares
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.assignment import check_ranges
from concord.scenarios.types.buses import Ideal
from concord.scenarios.types.rules import NumberRule

ALTERNATIVE_SCHEDULES = ("hybrid", "dynamic", "round-robin")
ANY_STRETCH = 1e9


class Rehearsal(NamedTuple):
    """Shares that each node sent, and dynamic-segment bids; both (steps, rounds, N)."""

    sent: SentShares
    asked: np.ndarray

    @property
    def published(self) -> np.ndarray:
        """Return the nodes that published (steps, rounds, N)."""
        return self.sent.whole.payload_bytes > 0

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
    bus: FlexRayBus


def prepare_without_bus(scenario: Scenario) -> Setup:
    """Return the scenario worked out whether or not its cluster holds its schedule, and in time.

    Raises:
        ValueError: for any other mistake.
    """
    check_ranges(scenario)
    patient, _ = scenario.with_known(stretch=ANY_STRETCH)
    try:
        setup = prepare(patient)
    except ValueError as refusal:
        try:
            setup = prepare(msgspec.structs.replace(patient, bus=Ideal()))
        except ValueError:
            raise refusal from None
    return msgspec.structs.replace(setup, scenario=scenario)


def changed(setup: Setup, **fields: object) -> Setup:
    """Return the setup with other choices about its bus."""
    scenario, _ = setup.scenario.with_known(**fields)
    return msgspec.structs.replace(setup, scenario=scenario)


def alternatives(setup: Setup) -> list[Alternative]:
    """Per schedule and number format the largest occupancy whose shares all fit, largest first."""
    rule = setup.scenario.rule
    numbers = dict.fromkeys((rule.number, "float32")) if isinstance(rule, NumberRule) else ("",)
    found = [
        _largest(changed(setup, schedule=schedule, **({"number": number} if number else {})))
        for number in numbers
        for schedule in ALTERNATIVE_SCHEDULES
    ]
    fitting = [alternative for alternative in found if alternative is not None]
    return sorted(fitting, key=lambda one: -shares_per_cycle(one.bus.schedule))


def shares_per_cycle(schedule: Schedule) -> int:
    """Most shares that a schedule lets into a cycle."""
    return max(
        len(schedule.static_senders(cycle)) + schedule.dynamic_slots(cycle)
        for cycle in range(schedule.period)
    )


def rehearse(setup: Setup, bus: FlexRayBus, steps: int) -> Rehearsal:
    """Go through so many steps of a schedule without filters."""
    scenario, schedule = setup.scenario, bus.schedule
    cycles = steps * scenario.rounds
    payload_bytes = np.zeros((cycles, scenario.nodes), dtype=np.int64)
    classes = np.zeros_like(payload_bytes)
    asked, cut = np.zeros((2, cycles, scenario.nodes), dtype=bool)
    state = begin_arbitration(scenario.nodes)
    assert isinstance(bus.classes, UrgencyClasses), "a cluster of FlexRay has these"
    silent = [0] * scenario.nodes
    for cycle in range(cycles):
        contenders = sorted(schedule.contenders(cycle))
        senders = schedule.static_senders(cycle)
        if contenders:
            sizes = np.array([_payload_bytes(bus, i, cycle) for i in contenders])
            bids = bus.classes.spread(np.array([silent[i] for i in contenders]) / len(contenders))
            awards = bus.arbitrate(state, cycle, 0, contenders, bids, partial(np.array, sizes))
            state, winners = awards.state, np.array(contenders)[awards.wins]
            asked[cycle, contenders] = True
            classes[cycle, winners] = awards.classes[awards.wins]
            senders += tuple(winners.tolist())
            for node, frames, urgency_class in awards.cut_shares(contenders):
                payload_bytes[cycle, node] = _payload_bytes(bus, node, cycle, frames)
                classes[cycle, node], cut[cycle, node] = urgency_class, True
        for node in senders:
            payload_bytes[cycle, node] = _payload_bytes(bus, node, cycle)
        whole = (payload_bytes[cycle] > 0) & ~cut[cycle]
        silent = [
            0 if sent else waited + 1 for sent, waited in zip(whole.tolist(), silent, strict=True)
        ]
    shape = (steps, scenario.rounds, scenario.nodes)
    sent = SentShares(
        payload_bytes.reshape(shape),
        classes.reshape(shape),
        cut.reshape(shape) if cut.any() else None,
    )
    return Rehearsal(sent, asked.reshape(shape))


def _payload_bytes(bus: FlexRayBus, node: int, cycle: int, frames: int | None = None) -> int:
    return sum(slot.payload_bytes for slot in bus.slots(node, cycle)[0][:frames])


def _largest(setup: Setup) -> Alternative | None:
    """Return the largest occupancy that fits; fewer publishers never need more room."""
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
        bus = build_bus(setup)
    except ValueError:
        return None
    if not isinstance(bus, FlexRayBus):
        return None
    fits = bus.dynamic_room() >= max(bus.schedule.dynamic_slot_table)
    return Alternative(setup, bus) if fits else None
