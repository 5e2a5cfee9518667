"""Arbiters by name, of the table or of a user's file."""

from concord.bus.arbitration import ARBITERS, Arbiter
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.schedules import arbiter_of
from concord.scenarios.user.values import function_or, is_source_name, pinned, source_of
from concord.topology.names import unknown_name


def with_pinned_arbiter(scenario: Scenario) -> Scenario:
    """The scenario with the digest of its arbiter's file beside its name, if it has such a file.

    Raises:
        ValueError: there is no such file.
    """
    name = arbiter_of(scenario.bus.schedule)
    return scenario.with_(arbiter=pinned(name)) if is_source_name(name) else scenario


def arbiter_named(name: str) -> Arbiter:
    """The arbiter of a name, or of a user's file: an `Arbiter`, or its function of urgency."""
    if not is_source_name(name):
        if name not in ARBITERS:
            raise unknown_name("arbiter", name, ARBITERS)
        return ARBITERS[name]
    must = "a function urgency(state, bids, frame_ids), or an Arbiter of concord.bus.arbitration"
    value = function_or(Arbiter, source_of(name), must)
    return value if isinstance(value, Arbiter) else Arbiter(value)
