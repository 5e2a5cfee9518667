"""One case of simulation testing: a scenario, its changes, and the faults of its wire."""

from collections.abc import Mapping
from typing import Any

import msgspec

from concord.experiments.simulation_testing.script import calm_from
from concord.experiments.simulation_testing.wire import read_wire
from concord.scenarios.scenario import Scenario
from concord.scenarios.script import script_of
from concord.scenarios.types.assignment import flat


class SimulationCase(msgspec.Struct, frozen=True):
    """Equal cases give equal runs, bit for bit.

    Attributes:
        seed: of what the wire does to messages.
        scenario: what is simulated; its `changes` are faults and their ends.
        wire: kinds and probabilities, "garbage 0.2" (`wire`).
    """

    seed: int
    scenario: Scenario
    wire: tuple[str, ...]

    @property
    def calm_step(self) -> int:
        """First step after the end of all faults."""
        return calm_from(script_of(self.scenario), self.scenario.steps)


# Options of the command that set fields of a case, beside the fields of its scenario.
OWN_FIELDS = ("wire",)


def with_fields(case: SimulationCase, fields: Mapping[str, Any]) -> SimulationCase:
    """Return the case with these fields of its own or of its scenario."""
    own = {name: value for name, value in fields.items() if name in OWN_FIELDS}
    other = {name: value for name, value in fields.items() if name not in OWN_FIELDS}
    scenario, _ = case.scenario.with_known(**other)
    return msgspec.structs.replace(case, scenario=scenario, **own)


def check_case(case: SimulationCase) -> None:
    """Refuse a wire that cannot be read.

    Raises:
        ValueError: naming the option, its value and the rule.
    """
    read_wire(case.wire)


def differences(case: SimulationCase, drawn: SimulationCase) -> dict[str, Any]:
    """Return the fields in which a case is not the drawn one, by the names of options."""
    one, other = _fields(case), _fields(drawn)
    return {name: value for name, value in one.items() if value != other.get(name)}


def _fields(case: SimulationCase) -> dict[str, Any]:
    return {**flat(case.scenario), **{name: getattr(case, name) for name in OWN_FIELDS}}
