"""The bound of the age of information in a network, by its schedule, graph and arbiter."""

from collections.abc import Sequence

from concord.bus.contended_bus import ContendedBus
from concord.bus.information_age import worst_age_steps, worst_contended_age_steps
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.labelled import flooding_of
from concord.scenarios.scenario import lossy_links
from concord.scenarios.setup import Setup
from concord.scenarios.types.rules import FloodingRule
from concord.scenarios.types.schedules import arbiter_of, trigger_of
from concord.studies.design.candidates import Candidate, placed
from concord.studies.sweep.specification import Value

_APART = "a node never hears of another"


def bound_steps_of(one: Candidate, placements: Sequence[Value] = ()) -> int | None:
    """Return the bound of a candidate's age with the sensors at any of these placements; None for
    no bound."""
    bounds = [age_bound(prepare(scenario))[0] for scenario in placed(one.cell.scenario, placements)]
    known = [bound for bound in bounds if bound is not None]
    return max(known) if len(known) == len(bounds) else None


def age_bound(setup: Setup) -> tuple[int | None, str]:
    """Return for how many steps a node may lack readings that another has taken, at most; and what
    this follows from beside schedule and graph. None where there is no bound, and then why."""
    scenario, bus = setup.scenario, build_bus(setup)
    schedule, contention = bus.schedule, scenario.bus.schedule
    floods = isinstance(scenario.rule, FloodingRule)
    if scenario.changes:
        return None, "the network changes"
    if lossy_links(scenario):
        return None, "links lose frames"
    if floods and flooding_of(scenario).withhold_below > 0:
        return None, "a node withholds readings (--withhold-below)"
    if not any(schedule.contenders(cycle) for cycle in range(schedule.period)):
        worst = worst_age_steps(schedule, setup.neighbours, scenario.rounds)
        return worst, "" if worst is not None else _APART
    if trigger_of(contention) > 0:
        return None, "a node with little news (--trigger) is silent, however old its last share is"
    wait = bus.longest_wait if isinstance(bus, ContendedBus) else None
    if wait is None:
        return None, f"a node may lose every contest with --arbiter {arbiter_of(contention)}"
    if floods:
        # A node without news does not ask.
        wait = wait._replace(next_cycles=wait.first_cycles)
    worst = worst_contended_age_steps(schedule, setup.neighbours, scenario.rounds, wait)
    if worst is None:
        return None, _APART
    return worst, f"a contender wins once in {wait.next_cycles} cycles at least"
