"""Shares that a bus would hold, in place of those that it does not."""

from collections.abc import Iterator

import numpy as np

from concord.bus.schedule import publishers_per_cycle
from concord.scenarios.bus_table.bus_plan import plan_bus
from concord.scenarios.rule_table.rules import rule_of, share_size, wire_number
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import FlexRay, stretch_of
from concord.scenarios.types.rules import NumberRule
from concord.scenarios.types.schedules import occupancy_of

_NUMBERS = ("float64", "float32", "float16")
_OCCUPANCIES = 12


def what_fits(setup: Setup) -> str:
    """Say how long shares are, and which options make a bus that holds them, each by itself.

    Every option that is named has been tried.
    """
    scenario = setup.scenario
    size = share_size(scenario, len(setup.prior_mean))
    found = list(_options(setup))
    fits = (
        f"one of these fits: {', '.join(found)}"
        if found
        else ("no smaller format or occupancy fits; use fewer states, or --bus ideal")
    )
    return f"a share of rule {scenario.rule.name} has up to {size:,} bytes; {fits}"


def _options(setup: Setup) -> Iterator[str]:
    scenario = setup.scenario
    smaller: list[str] = []
    if isinstance(scenario.rule, NumberRule):
        smaller = list(_NUMBERS[_NUMBERS.index(scenario.rule.number) + 1 :])
    for number in smaller:
        if size := _fitting(setup, number=number):
            yield f"--number {number} ({size:,} bytes)"
    for schedule in ({}, {"schedule": "round-robin"}):
        if found := _most_senders(setup, schedule):
            yield found
            break
    else:
        if smaller and (found := _most_senders(setup, {**schedule, "number": smaller[-1]})):
            yield found
    is_other = isinstance(scenario.bus, FlexRay) and scenario.bus.cluster != "fitted"
    if is_other and _fitting(setup, cluster="fitted"):
        yield "--cluster fitted"
    if _fitting(setup, bus="ideal"):
        yield "--bus ideal"


def _most_senders(setup: Setup, others: dict[str, str]) -> str:
    """The greatest occupancy that fits beside other options; empty for none."""
    scenario = setup.scenario
    senders = publishers_per_cycle(scenario.nodes, occupancy_of(scenario.bus.schedule))
    if senders < 2:
        return ""
    counts = np.unique(np.linspace(1, senders - 1, _OCCUPANCIES).round()).tolist()
    for count in reversed(counts):
        occupancy = round(count / scenario.nodes, 3)
        if _fitting(setup, occupancy=occupancy, **others):
            words = (f"--{name} {value}" for name, value in others.items())
            return " ".join((f"--occupancy {occupancy:g}", *words))
    return ""


def _fitting(setup: Setup, **changes: object) -> int | None:
    """Bytes of the longest share where the bus holds it after these changes; None elsewhere."""
    try:
        other: Scenario = setup.scenario.with_(**changes)
        share = rule_of(other).share
        if share is not None and not share.has(wire_number(other)):
            return None
        size = share_size(other, len(setup.prior_mean))
        bus = plan_bus(other, size, setup.neighbours)
        bus.check_pace(other.rounds, setup.time_step_s, stretch_of(other.bus))
    except ValueError:
        return None
    return size
