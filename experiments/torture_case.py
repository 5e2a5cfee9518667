"""One case of torture: a scenario, what becomes of its network, and a wire that is no good."""

from collections.abc import Mapping
from typing import Any

import msgspec

from experiments.torture_script import calm_from
from experiments.torture_wire import read_wire
from scenarios.scenario import Scenario
from scenarios.script import script_of


class Case(msgspec.Struct, frozen=True):
    """Equal cases give equal runs, bit for bit.

    Attributes:
        seed: of what the wire does to messages.
        scenario: what is simulated; its `changes` are faults and their ends.
        wire: kinds and probabilities, "garbage 0.2" (`torture_wire`).
    """

    seed: int
    scenario: Scenario
    wire: tuple[str, ...]

    @property
    def calm_step(self) -> int:
        """From this step on nothing is wrong any more."""
        return calm_from(script_of(self.scenario), self.scenario.steps)


# What an option of the command may say of a case, beside the fields of its scenario.
OWN_FIELDS = ("wire",)


def with_fields(case: Case, fields: Mapping[str, Any]) -> Case:
    """The case with these fields of its own or of its scenario."""
    own = {name: value for name, value in fields.items() if name in OWN_FIELDS}
    other = {name: value for name, value in fields.items() if name not in OWN_FIELDS}
    scenario = msgspec.structs.replace(case.scenario, **other)
    return msgspec.structs.replace(case, scenario=scenario, **own)


def check_case(case: Case) -> None:
    """Refuse a wire that is none.

    Raises:
        ValueError: naming the option, its value and the rule.
    """
    read_wire(case.wire)


def differences(case: Case, drawn: Case) -> dict[str, Any]:
    """The fields in which a case is not the drawn one, by the names of options."""
    one, other = _fields(case), _fields(drawn)
    return {name: value for name, value in one.items() if value != other[name]}


def _fields(case: Case) -> dict[str, Any]:
    scenario = {name: getattr(case.scenario, name) for name in case.scenario.__struct_fields__}
    return {**scenario, **{name: getattr(case, name) for name in OWN_FIELDS}}
